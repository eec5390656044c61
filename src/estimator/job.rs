//! One request on its way through the queue, with the way back.

use std::time::{Duration, Instant};

use image::RgbImage;
use thiserror::Error;
use tokio::sync::{OwnedSemaphorePermit, oneshot};

use super::answer::{Abandoned, Estimate, EstimateError, MeasureError, Selection};
use crate::vision::{BoundingBox, DecodeError, Exif};
use posed_core::geometry::Camera;
use posed_core::pnp::Solution;

/// One image to estimate poses from.
#[derive(Clone, Debug)]
pub struct Work {
    /// Encoded image.
    pub image: Vec<u8>,
    pub camera: Camera,
    pub selection: Selection,
    /// Give the pixels back with the answer: for a picture of it.
    pub keep_image: bool,
    /// After this nobody waits any more.
    pub deadline: Instant,
}

/// A reference image to solve one object's keypoints in.
#[derive(Clone, Debug)]
pub struct ReferenceWork {
    /// Encoded image.
    pub image: Vec<u8>,
    pub camera: Camera,
    pub object: String,
    /// The object's box; the detector's where there is none.
    pub region: Option<BoundingBox>,
    pub deadline: Instant,
}

/// An estimate with what the way to it cost.
#[derive(Debug)]
pub struct Answer {
    pub estimate: Estimate,
    pub exif: Exif,
    /// The pixels, where they were asked for.
    pub image: Option<RgbImage>,
    /// Images that were worked on together, this one included.
    pub batch_size: usize,
    pub queued: Duration,
    pub decode: Duration,
    pub total: Duration,
}

/// Why there is no estimate.
#[derive(Debug, Error)]
pub enum QueueError {
    #[error("{limit} images are waiting already ('queue'); try again in a moment")]
    Full { limit: usize },
    #[error("{limit} bytes of images are waiting already ('queue_bytes'); try again in a moment")]
    FullBytes { limit: usize },
    #[error(transparent)]
    Abandoned(#[from] Abandoned),
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    #[error(transparent)]
    Measure(#[from] MeasureError),
    #[error("the estimator failed on this image; the fault is logged")]
    Crashed,
}

/// What is wanted of an image, and where it goes.
pub(super) enum Task {
    Poses { selection: Selection, keep_image: bool, reply: oneshot::Sender<Result<Answer, QueueError>> },
    Reference { object: String, region: Option<BoundingBox>, reply: oneshot::Sender<Result<Solved, QueueError>> },
}

/// A reference image's box and keypoint pose.
pub type Solved = (BoundingBox, Solution);

/// Admitted: from here on it holds a place in the queue until it is dropped.
pub(super) struct Job {
    pub image: Vec<u8>,
    pub camera: Camera,
    pub task: Task,
    pub deadline: Instant,
    pub arrived: Instant,
    pub place: Place,
}

/// A share of the queue's bounds. Given up before the caller is answered, so that its next request finds room.
pub(super) struct Place {
    pub _image: OwnedSemaphorePermit,
    pub _bytes: OwnedSemaphorePermit,
}

impl Job {
    /// Whether somebody still waits for the answer.
    pub(super) fn wanted(&self) -> Result<(), Abandoned> {
        let gone = match &self.task {
            Task::Poses { reply, .. } => reply.is_closed(),
            Task::Reference { reply, .. } => reply.is_closed(),
        };
        if Instant::now() >= self.deadline {
            Err(Abandoned::Expired)
        } else if gone {
            Err(Abandoned::Cancelled)
        } else {
            Ok(())
        }
    }

    /// Answers with an error.
    pub(super) fn fail(self, error: QueueError) {
        let Self { task, place, .. } = self;
        drop(place);
        // A caller that has left meanwhile is no fault.
        match task {
            Task::Poses { reply, .. } => drop(reply.send(Err(error))),
            Task::Reference { reply, .. } => drop(reply.send(Err(error))),
        }
    }
}
