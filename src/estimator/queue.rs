//! The estimator as a service within the process: bounded, with deadlines, answered by workers.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use posed_core::geometry::Camera;
use tokio::sync::oneshot;

use super::admission::{Admission, BodyLease, Place, Refusal, Room};
use super::answer::Abandoned;
use super::cores::Cores;
use super::job::{Answer, Job, Located, QueueError, ReferenceWork, Slot, Task, Work};
use super::pace::Pace;
use super::pipeline::Estimator;
use super::prepare::Decoders;
use super::stats::Stats;
use super::update::Update;
use super::worker::{self, Batching, StartError, Workers};
use crate::model::RuntimeError;
use crate::vision::{DecodeOptions, Image};

/// How much may be there at once, and how it is worked on.
#[derive(Clone, Copy, Debug)]
pub struct QueueConfig {
    pub room: Room,
    /// Images decoded at the same time.
    pub decoders: usize,
    pub decode: DecodeOptions,
    /// Threads that each own a set of networks.
    pub workers: usize,
    /// Images worked on together.
    pub max_batch: usize,
    /// How long a batch waits for company.
    pub batch_delay: Duration,
    /// A worker whose batch takes longer is taken out until it comes back.
    pub worker_timeout: Duration,
}

/// A bounded queue before the workers that own the networks. Clones are the same queue.
#[derive(Clone, Debug)]
pub struct Queue {
    admission: Admission,
    decoders: Decoders,
    jobs: crossbeam_channel::Sender<Slot>,
    /// One for each worker.
    updates: Vec<crossbeam_channel::Sender<Update>>,
    pace: Arc<Pace>,
    stats: Arc<Stats>,
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
        let stats = Arc::new(Stats::default());
        // Every job holds a place, so that the jobs in the channel are bounded by them; who leaves leaves an empty slot.
        let (jobs, receiver) = crossbeam_channel::unbounded();
        let pace = Arc::new(Pace::new(config.workers));
        let workers = Workers {
            make: Arc::new(make),
            batching: Batching { most: config.max_batch, delay: config.batch_delay },
            jobs: receiver,
            pace: Arc::clone(&pace),
            stats: Arc::clone(&stats),
            cores: Arc::new(Cores::new(config.workers)),
        };
        let updates = worker::start(config.workers, config.worker_timeout, &workers)?;
        let admission = Admission::new(config.room);
        let decoders = Decoders::new(admission.clone(), config.decoders, config.decode);
        Ok(Self { admission, decoders, jobs, updates, pace, stats })
    }

    /// How many workers there are: each needs an [`Update`] of its own.
    #[must_use]
    pub fn workers(&self) -> usize {
        self.updates.len()
    }

    /// What the workers go on with, each before its next batch. Images that come after this are answered with it.
    pub fn adopt(&self, updates: impl IntoIterator<Item = Update>) {
        for (worker, update) in self.updates.iter().zip(updates) {
            // One that has ended needs nothing more.
            drop(worker.send(update));
        }
    }

    /// Estimates poses from one image. Dropping the future takes the image out of the queue.
    ///
    /// # Errors
    /// [`QueueError::Refused`] at once when the queue is full, or the answer would come late; [`Abandoned::Expired`] at the
    /// deadline, whatever the workers do; otherwise what decoding or estimating says.
    pub async fn estimate(&self, work: Work) -> Result<Answer, QueueError> {
        let Work { image, body, camera, selection, guide, keep_image, deadline } = work;
        let (reply, answer) = oneshot::channel();
        let task = Task::Poses { selection, guide, keep_image, reply };
        self.run(Request { image, body, camera, task, keep_image, deadline }, answer).await
    }

    /// Solves an object's keypoints in one reference image.
    ///
    /// # Errors
    /// As [`Queue::estimate`].
    pub async fn measure(&self, work: ReferenceWork) -> Result<Located, QueueError> {
        let ReferenceWork { image, body, camera, object, region, deadline } = work;
        let (reply, answer) = oneshot::channel();
        let task = Task::Reference { object, region, reply };
        self.run(Request { image, body, camera, task, keep_image: false, deadline }, answer).await
    }

    /// Whether an image that is still to come would be answered by its deadline, as far as is known now.
    ///
    /// # Errors
    /// [`Refusal`] where there is no place, no worker, or not enough time.
    pub fn may_come(&self, deadline: Instant) -> Result<(), Refusal> {
        self.admission.has_place()?;
        self.in_time(self.admission.images(), deadline)
    }

    fn in_time(&self, ahead: usize, deadline: Instant) -> Result<(), Refusal> {
        if self.stats.lost_workers.load(Ordering::Relaxed) >= self.workers() {
            return Err(Refusal::NoWorkers);
        }
        self.pace.may_come(ahead, deadline)
    }

    #[must_use]
    pub fn stats(&self) -> &Stats {
        &self.stats
    }

    /// The room before the workers: to be asked before a body is read.
    #[must_use]
    pub fn admission(&self) -> &Admission {
        &self.admission
    }

    async fn run<T>(
        &self,
        request: Request,
        answer: oneshot::Receiver<Result<T, QueueError>>,
    ) -> Result<T, QueueError> {
        let arrived = Instant::now();
        let Request { image, body, camera, task, keep_image, deadline } = request;
        let admitted = self.admit(&image, body, deadline);
        let (place, body) = admitted.inspect_err(|_| Stats::count(&self.stats.refused))?;
        Stats::count(&self.stats.admitted);
        let mut waiting = Waiting { stats: &self.stats, at: Stage::Decoding, why: Abandoned::Cancelled };
        let answered = async {
            let pixels = self.decoders.decode(image, body, keep_image, arrived).await;
            waiting.at = Stage::Counted;
            let pixels = pixels.inspect_err(|_| Stats::count(&self.stats.undecodable))?;
            let slot = Slot::new(Job { pixels, camera, task, deadline, arrived, place });
            // Closed only when no worker is left.
            self.jobs.send(slot.clone()).map_err(|_| QueueError::Crashed)?;
            waiting.at = Stage::Queued(slot);
            // The reply is dropped without an answer where no worker is left, or a panic spoilt the batch before it.
            answer.await.unwrap_or(Err(QueueError::Crashed))
        };
        let in_time = tokio::time::timeout_at(deadline.into(), answered).await;
        in_time.unwrap_or_else(|_| {
            waiting.why = Abandoned::Expired;
            Err(Abandoned::Expired.into())
        })
    }

    fn admit(
        &self,
        image: &Image,
        body: Option<Arc<BodyLease>>,
        deadline: Instant,
    ) -> Result<(Place, Arc<BodyLease>), QueueError> {
        let place = self.admission.place()?;
        // Its own place is among them.
        self.in_time(self.admission.images().saturating_sub(1), deadline)?;
        let body = match body {
            Some(body) => body,
            None => Arc::new(self.admission.body(image.byte_count())?),
        };
        Ok((place, body))
    }
}

/// What [`Work`] and [`ReferenceWork`] have in common.
struct Request {
    image: Image,
    body: Option<Arc<BodyLease>>,
    camera: Camera,
    task: Task,
    keep_image: bool,
    deadline: Instant,
}

/// An image that no worker has yet. Where it is given up it is counted, and leaves the queue.
struct Waiting<'a> {
    stats: &'a Stats,
    at: Stage,
    /// Of giving up.
    why: Abandoned,
}

enum Stage {
    Decoding,
    /// Until a worker takes it, which then counts what becomes of it.
    Queued(Slot),
    Counted,
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        let given_up = match &self.at {
            Stage::Decoding => true,
            Stage::Queued(slot) => slot.take().is_some(),
            Stage::Counted => false,
        };
        if given_up {
            self.stats.abandon(self.why);
        }
    }
}
