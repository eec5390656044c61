use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{Semaphore, oneshot};

use super::answer::Abandoned;
use super::job::{Answer, Job, Place, QueueError, ReferenceWork, Solved, Task, Work};
use super::workers;
use super::{Estimator, StartError};
use crate::model::RuntimeError;
use crate::vision::DecodeOptions;
use posed_core::geometry::Camera;

/// How much may wait, and how it is worked on.
#[derive(Clone, Copy, Debug)]
pub struct QueueConfig {
    /// Images in work or waiting.
    pub limit: usize,
    /// Bytes of encoded images in work or waiting.
    pub limit_bytes: usize,
    /// Threads that each own a set of networks.
    pub workers: usize,
    /// Images worked on together.
    pub max_batch: usize,
    /// How long a batch waits for company.
    pub batch_delay: Duration,
    pub decode: DecodeOptions,
}

/// What has gone through a queue since its start.
#[derive(Debug, Default)]
pub struct QueueStats {
    pub admitted: AtomicU64,
    pub refused: AtomicU64,
    /// Given to a worker.
    pub worked: AtomicU64,
    pub expired: AtomicU64,
    pub cancelled: AtomicU64,
    pub batches: AtomicU64,
    pub worker_restarts: AtomicU64,
    /// Workers that can take a batch.
    pub ready_workers: AtomicUsize,
}

impl QueueStats {
    pub(super) fn count_abandoned(&self, why: Abandoned) {
        count(match why {
            Abandoned::Expired => &self.expired,
            Abandoned::Cancelled => &self.cancelled,
        });
    }
}

/// A bounded queue before the workers that own the networks.
#[derive(Clone, Debug)]
pub struct Queue {
    jobs: crossbeam_channel::Sender<Job>,
    /// Count jobs from arrival to answer, so that the bounds include those being worked on.
    places: Arc<Semaphore>,
    bytes: Arc<Semaphore>,
    config: QueueConfig,
    stats: Arc<QueueStats>,
}

impl Queue {
    /// Starts the workers, each with an estimator of its own, warmed up. They end once every `Queue` is dropped and the last
    /// job is answered.
    ///
    /// # Errors
    /// When the system gives no thread, or an estimator cannot be made.
    pub fn start(
        config: QueueConfig,
        make: impl Fn() -> Result<Estimator, RuntimeError> + Send + Sync + 'static,
    ) -> Result<Self, StartError> {
        let stats = Arc::new(QueueStats::default());
        let (jobs, receiver) = crossbeam_channel::bounded(config.limit);
        workers::start(config, receiver, &(Arc::new(make) as _), &stats)?;
        let (places, bytes) = (Arc::new(Semaphore::new(config.limit)), Arc::new(Semaphore::new(config.limit_bytes)));
        Ok(Self { jobs, places, bytes, config, stats })
    }

    /// Estimates poses from one image. Dropping the future takes the image out of the queue.
    ///
    /// # Errors
    /// [`QueueError::Full`] at once when the queue is full; [`Abandoned::Expired`] at the deadline, whatever the workers do;
    /// otherwise what decoding or estimating says.
    pub async fn estimate(&self, work: Work) -> Result<Answer, QueueError> {
        let Work { image, camera, selection, keep_image, deadline } = work;
        let (reply, answer) = oneshot::channel();
        self.submit(image, camera, deadline, Task::Poses { selection, keep_image, reply })?;
        self.wait(answer, deadline).await
    }

    /// Solves an object's keypoints in one reference image.
    ///
    /// # Errors
    /// As [`Queue::estimate`].
    pub async fn measure(&self, work: ReferenceWork) -> Result<Solved, QueueError> {
        let ReferenceWork { image, camera, object, region, deadline } = work;
        let (reply, answer) = oneshot::channel();
        self.submit(image, camera, deadline, Task::Reference { object, region, reply })?;
        self.wait(answer, deadline).await
    }

    #[must_use]
    pub fn stats(&self) -> &QueueStats {
        &self.stats
    }

    /// Images in work or waiting.
    #[must_use]
    pub fn depth(&self) -> usize {
        self.config.limit - self.places.available_permits()
    }

    fn submit(&self, image: Vec<u8>, camera: Camera, deadline: Instant, task: Task) -> Result<(), QueueError> {
        let place = self.admit(image.len()).inspect_err(|_| count(&self.stats.refused))?;
        let job = Job { image, camera, task, deadline, arrived: Instant::now(), place };
        // Never full: every job holds a place. Closed only when no worker is left.
        self.jobs.try_send(job).map_err(|_| QueueError::Crashed)?;
        count(&self.stats.admitted);
        Ok(())
    }

    fn admit(&self, size: usize) -> Result<Place, QueueError> {
        let full = |_| QueueError::Full { limit: self.config.limit };
        let image = Arc::clone(&self.places).try_acquire_owned().map_err(full)?;
        let full = QueueError::FullBytes { limit: self.config.limit_bytes };
        let Ok(size) = u32::try_from(size) else { return Err(full) };
        let bytes = Arc::clone(&self.bytes).try_acquire_many_owned(size).map_err(|_| full)?;
        Ok(Place { _image: image, _bytes: bytes })
    }

    async fn wait<T>(
        &self,
        answer: oneshot::Receiver<Result<T, QueueError>>,
        deadline: Instant,
    ) -> Result<T, QueueError> {
        match tokio::time::timeout_at(deadline.into(), answer).await {
            // The reply is dropped without an answer where no worker is left, or a panic spoilt the batch before it.
            Ok(answer) => answer.unwrap_or(Err(QueueError::Crashed)),
            Err(_) => Err(Abandoned::Expired.into()),
        }
    }
}

pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}
