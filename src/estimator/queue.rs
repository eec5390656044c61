use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use thiserror::Error;
use tokio::sync::{Semaphore, mpsc, oneshot};

use super::pipeline::{Estimate, EstimateError, Estimator};
use crate::geometry::Camera;
use crate::vision::{DecodeError, ImageLimits, decode};

/// One image to estimate poses from.
pub struct Work {
    /// Encoded image.
    pub image: Vec<u8>,
    pub camera: Camera,
}

/// An estimate with what the way to it cost.
#[derive(Debug)]
pub struct Answer {
    pub estimate: Estimate,
    pub queued: Duration,
    pub decode: Duration,
    pub total: Duration,
}

/// Why there is no estimate.
#[derive(Debug, Error)]
pub enum QueueError {
    #[error("{limit} images are waiting already; try again in a moment")]
    Full { limit: usize },
    #[error("the server is shutting down")]
    Closed,
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    #[error("the estimator failed on this image; the fault is logged")]
    Crashed,
}

/// Work on its way to the estimator, with the way back.
pub struct Job {
    work: Work,
    reply: oneshot::Sender<Result<Answer, QueueError>>,
    arrived: Instant,
}

/// A bounded queue before the one thread that owns the networks.
#[derive(Clone)]
pub struct Queue {
    sender: mpsc::Sender<Job>,
    /// Counts jobs from arrival to answer, so that the bound includes the one being worked on.
    places: Arc<Semaphore>,
    limit: usize,
}

impl Queue {
    /// Starts the estimator's thread. It ends once every `Queue` is dropped and the last job is answered.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(
        estimator: Estimator,
        limit: usize,
        image_limits: ImageLimits,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (sender, receiver) = mpsc::channel(limit);
        let worker = std::thread::Builder::new()
            .name("estimator".into())
            .spawn(move || work_through(estimator, receiver, &image_limits))?;
        Ok((Self { sender, places: Arc::new(Semaphore::new(limit)), limit }, worker))
    }

    /// Estimates poses from one image. Dropping the future takes the image out of the queue.
    ///
    /// # Errors
    /// [`QueueError::Full`] at once when the queue is full; otherwise what decoding or estimating says.
    pub async fn estimate(&self, work: Work) -> Result<Answer, QueueError> {
        let _place = self.places.try_acquire().map_err(|_| QueueError::Full { limit: self.limit })?;
        let (reply, answer) = oneshot::channel();
        let job = Job { work, reply, arrived: Instant::now() };
        self.sender.send(job).await.map_err(|_| QueueError::Closed)?;
        // The worker drops the reply without an answer only where it panicked.
        answer.await.unwrap_or(Err(QueueError::Crashed))
    }
}

fn work_through(mut estimator: Estimator, mut receiver: mpsc::Receiver<Job>, limits: &ImageLimits) {
    while let Some(Job { work, reply, arrived }) = receiver.blocking_recv() {
        if reply.is_closed() {
            continue; // the caller has gone
        }
        let queued = arrived.elapsed();
        // The networks keep no state between runs, so a panic on one image does not spoil the next.
        let answer = catch_unwind(AssertUnwindSafe(|| {
            let start = Instant::now();
            let image = decode(&work.image, limits)?;
            let decode = start.elapsed();
            let estimate = estimator.estimate(&image, &work.camera)?;
            Ok(Answer { estimate, queued, decode, total: arrived.elapsed() })
        }));
        if let Ok(answer) = answer {
            // A caller that has left meanwhile is no fault.
            drop(reply.send(answer));
        } else {
            tracing::error!("estimating panicked; the image is answered with an error");
        }
    }
}
