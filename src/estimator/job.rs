//! One image on its way through the estimator, with the way back.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use image::RgbImage;
use posed_core::geometry::Camera;
use posed_core::pnp::Solution;
use thiserror::Error;
use tokio::sync::oneshot;

use super::admission::{BodyLease, PixelLease, Place, Refusal};
use super::answer::{Abandoned, Estimate, EstimateError, KeypointPrediction, MeasureError, Selection};
use super::expected::Guide;
use super::prepare::{Pixels, PrepareError};
use crate::vision::{BoundingBox, Exif, Image};

/// One image to estimate poses from.
#[derive(Clone, Debug)]
pub struct Work {
    pub image: Image,
    /// The room that the image's bytes take, where it was asked for before they came.
    pub body: Option<Arc<BodyLease>>,
    pub camera: Camera,
    pub selection: Selection,
    /// What earlier images of its stream say.
    pub guide: Option<Guide>,
    /// Give the pixels back with the answer: for a picture of it.
    pub keep_image: bool,
    /// After this nobody waits any more.
    pub deadline: Instant,
}

/// A reference image to solve one object's keypoints in.
#[derive(Clone, Debug)]
pub struct ReferenceWork {
    pub image: Image,
    /// As [`Work::body`].
    pub body: Option<Arc<BodyLease>>,
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
    /// The room that these pixels take: held until they, and what is made of them, are gone.
    pub room: Option<PixelLease>,
    /// Images that were worked on together, this one included.
    pub batch_size: usize,
    pub queued: Duration,
    pub decode: Duration,
    pub total: Duration,
}

/// Why there is no estimate.
#[derive(Debug, Error)]
pub enum QueueError {
    #[error(transparent)]
    Refused(#[from] Refusal),
    #[error(transparent)]
    Abandoned(#[from] Abandoned),
    #[error(transparent)]
    Decode(#[from] crate::vision::DecodeError),
    #[error(
        "the image is too costly to decode: it can take {bytes} bytes, the limit is {limit} ('pixel_bytes'); post a smaller \
         image, or a JPEG or PNG"
    )]
    TooCostly { bytes: u64, limit: usize },
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    #[error(transparent)]
    Measure(#[from] MeasureError),
    #[error("the server failed on this image; its log has the details")]
    Crashed,
}

impl From<PrepareError> for QueueError {
    fn from(error: PrepareError) -> Self {
        match error {
            PrepareError::Decode(error) => Self::Decode(error),
            PrepareError::TooCostly { bytes, limit } => Self::TooCostly { bytes, limit },
            PrepareError::Crashed => Self::Crashed,
        }
    }
}

/// What is wanted of an image, and where it goes.
pub(super) enum Task {
    Poses {
        selection: Selection,
        guide: Option<Guide>,
        keep_image: bool,
        reply: oneshot::Sender<Result<Answer, QueueError>>,
    },
    Reference {
        object: String,
        region: Option<BoundingBox>,
        reply: oneshot::Sender<Result<Located, QueueError>>,
    },
}

/// Where a reference image shows its object.
pub struct Located {
    pub region: BoundingBox,
    pub prediction: KeypointPrediction,
    /// Pose of the virtual keypoints, as large as the network learned them.
    pub solution: Solution,
}

/// An image that waits for a worker. It holds its place until it is dropped.
pub(super) struct Job {
    pub pixels: Pixels,
    pub camera: Camera,
    pub task: Task,
    pub deadline: Instant,
    pub arrived: Instant,
    pub place: Place,
}

/// A job in the queue. Whoever takes it first has it: a worker, or its caller who leaves, and its room is free at once.
#[derive(Clone)]
pub(super) struct Slot(Arc<Mutex<Option<Job>>>);

impl Slot {
    pub(super) fn new(job: Job) -> Self {
        Self(Arc::new(Mutex::new(Some(job))))
    }

    pub(super) fn take(&self) -> Option<Job> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Job {
    /// An error where nobody waits for the answer any more.
    pub(super) fn abandoned(&self) -> Result<(), Abandoned> {
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

    /// Answers with poses. Room is given back first, so that the caller's next request finds it.
    pub(super) fn answer(self, estimate: Estimate, batch_size: usize) {
        let Self { pixels, task, arrived, place, .. } = self;
        drop(place);
        let Task::Poses { keep_image, reply, .. } = task else { return };
        let Pixels { image, exif, room, queued, decode } = pixels;
        let (image, room) = if keep_image { (Some(image), Some(room)) } else { (None, None) };
        let total = arrived.elapsed();
        // A caller that has left meanwhile is no fault.
        drop(reply.send(Ok(Answer { estimate, exif, image, room, batch_size, queued, decode, total })));
    }

    /// Answers with what a reference image shows.
    pub(super) fn located(self, located: Located) {
        let Self { task, place, pixels, .. } = self;
        drop((place, pixels));
        if let Task::Reference { reply, .. } = task {
            drop(reply.send(Ok(located)));
        }
    }

    /// Answers with an error.
    pub(super) fn fail(self, error: QueueError) {
        let Self { task, place, pixels, .. } = self;
        drop((place, pixels));
        match task {
            Task::Poses { reply, .. } => drop(reply.send(Err(error))),
            Task::Reference { reply, .. } => drop(reply.send(Err(error))),
        }
    }
}
