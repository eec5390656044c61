//! The threads that own the networks: they take what waits, a batch at a time, and answer it.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};
use thiserror::Error;

use super::answer::{Abandoned, Estimate, EstimateError, Selection};
use super::cores::Cores;
use super::frame::Frame;
use super::job::{Job, QueueError, Slot, Task};
use super::pace::Pace;
use super::pipeline::Estimator;
use super::stats::Stats;
use super::update::Update;
use super::watchdog::{self, Activity};
use crate::model::RuntimeError;

/// Workers that cannot be started.
#[derive(Debug, Error)]
pub enum StartError {
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    #[error(transparent)]
    Network(#[from] RuntimeError),
    #[error("the networks cannot be run: {0}")]
    WarmUp(#[from] EstimateError),
    #[error("a worker failed while it loaded the networks; the log has the details")]
    Panicked,
}

/// What makes a worker's estimator, and makes it again after a panic.
pub(super) type Make = Arc<dyn Fn() -> Result<Estimator, RuntimeError> + Send + Sync>;

/// How workers form batches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batching {
    /// Images worked on together.
    pub most: usize,
    /// How long a batch waits for company.
    pub delay: Duration,
}

/// What workers share.
#[derive(Clone)]
pub(super) struct Workers {
    pub make: Make,
    pub batching: Batching,
    pub jobs: Receiver<Slot>,
    pub pace: Arc<Pace>,
    pub stats: Arc<Stats>,
    /// Of those that wait, for those that work.
    pub cores: Arc<Cores>,
}

/// Starts the workers and comes back once each of them is warmed up, with a sender of updates for each. They end with the
/// last sender of jobs. One whose batch takes longer than `timeout` is taken out until it comes back.
pub(super) fn start(count: usize, timeout: Duration, workers: &Workers) -> Result<Vec<Sender<Update>>, StartError> {
    let (started, starts) = crossbeam_channel::unbounded();
    let (mut watched, mut senders) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for index in 0..count {
        let (workers, started, activity) = (workers.clone(), started.clone(), Arc::new(Activity::default()));
        let name = format!("worker-{index}");
        watched.push((name.clone(), Arc::downgrade(&activity)));
        let (sender, updates) = crossbeam_channel::unbounded();
        senders.push(sender);
        let thread = std::thread::Builder::new().name(name.clone());
        thread.spawn(move || workers.work(&name, &activity, updates, started))?;
    }
    drop(started);
    for _ in 0..count {
        starts.recv().map_err(|_| StartError::Panicked)??;
    }
    watchdog::watch(timeout, watched, Arc::clone(&workers.stats))?;
    Ok(senders)
}

impl Workers {
    /// A worker's life: networks, batches, and after a panic new networks.
    fn work(
        &self,
        name: &str,
        activity: &Arc<Activity>,
        mut updates: Receiver<Update>,
        started: Sender<Result<(), StartError>>,
    ) {
        let stats = &self.stats;
        // A panic here is said like any other failure: the receiver waits for the word of every worker.
        let first = catch_unwind(AssertUnwindSafe(|| self.load(activity))).unwrap_or(Err(StartError::Panicked));
        let mut estimator = match first {
            Ok(estimator) => estimator,
            Err(error) => return drop(started.send(Err(error))),
        };
        stats.ready_workers.fetch_add(1, Ordering::Relaxed);
        let _ = started.send(Ok(()));
        drop(started);
        let mut next = None;
        while let Some(first) = next.take().or_else(|| self.wait(&mut estimator, &mut updates)) {
            let (batch, later) = self.gather(first);
            next = later;
            // Whoever saw a new catalogue in force before it asked is answered with it.
            updates.try_iter().for_each(|update| estimator.adopt(update));
            if batch.is_empty() {
                continue;
            }
            Stats::count(&stats.batches);
            self.pace.begin();
            activity.begin();
            let own = self.cores.own();
            let sound = self.answer(&mut estimator, batch);
            drop(own);
            activity.end(name, stats);
            if sound {
                continue;
            }
            stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
            Stats::count(&stats.worker_restarts);
            tracing::error!("a worker panicked: its images get an error, and it reloads its networks");
            let again = catch_unwind(AssertUnwindSafe(|| self.make(activity)));
            estimator = match again.map_err(|_| StartError::Panicked).and_then(|made| Ok(made?)) {
                Ok(estimator) => estimator,
                Err(error) => {
                    stats.lost_workers.fetch_add(1, Ordering::Relaxed);
                    return tracing::error!(%error, "{name} ends: it cannot reload its networks");
                }
            };
            stats.ready_workers.fetch_add(1, Ordering::Relaxed);
        }
        stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
    }

    fn make(&self, activity: &Arc<Activity>) -> Result<Estimator, RuntimeError> {
        let mut estimator = (self.make)()?;
        estimator.activity = Arc::clone(activity);
        estimator.cores = Arc::clone(&self.cores);
        Ok(estimator)
    }

    fn load(&self, activity: &Arc<Activity>) -> Result<Estimator, StartError> {
        let mut estimator = self.make(activity)?;
        estimator.warm_up()?;
        Ok(estimator)
    }

    /// The next job, and what is to be adopted until it comes; `None` once no more jobs can come.
    fn wait(&self, estimator: &mut Estimator, updates: &mut Receiver<Update>) -> Option<Job> {
        loop {
            crossbeam_channel::select! {
                recv(self.jobs) -> slot => if let Some(job) = slot.ok()?.take() {
                    return Some(job);
                },
                recv(updates) -> update => match update {
                    Ok(update) => estimator.adopt(update),
                    // The queue is gone; jobs that wait are still answered.
                    Err(_) => *updates = crossbeam_channel::never(),
                },
            }
        }
    }

    /// What waits, and what comes soon, as far as somebody waits for it and it can be in time. The second is a job that would
    /// make the batch late: it comes next.
    fn gather(&self, first: Job) -> (Vec<Job>, Option<Job>) {
        let Batching { most, delay } = self.batching;
        let closes = Instant::now() + delay;
        let mut batch: Vec<Job> = Vec::new();
        let mut next = Some(first);
        while let Some(job) = next {
            let deadline = batch.iter().map(|job| job.deadline).fold(job.deadline, Instant::min);
            match job.abandoned() {
                Ok(()) if self.pace.would_be_late(1, job.deadline) => self.abandon(job, Abandoned::Expired),
                Ok(()) if !batch.is_empty() && self.pace.would_be_late(batch.len() + 1, deadline) => {
                    return (batch, Some(job));
                }
                Ok(()) => batch.push(job),
                Err(why) => self.abandon(job, why),
            }
            let room = batch.len() < most;
            next = room.then(|| self.next_until(closes)).flatten();
        }
        (batch, None)
    }

    /// The next job whose caller has not left, if it comes in time.
    fn next_until(&self, closes: Instant) -> Option<Job> {
        let next = || self.jobs.recv_deadline(closes).or_else(|_| self.jobs.try_recv()).ok();
        std::iter::from_fn(next).find_map(|slot| slot.take())
    }

    /// Answers a batch; false where it panicked.
    fn answer(&self, estimator: &mut Estimator, batch: Vec<Job>) -> bool {
        let (poses, references): (Vec<_>, Vec<_>) =
            batch.into_iter().partition(|job| matches!(job.task, Task::Poses { .. }));
        let mut sound = poses.is_empty() || self.estimate(estimator, poses);
        for job in references {
            sound = sound && self.measure(estimator, job);
        }
        sound
    }

    fn estimate(&self, estimator: &mut Estimator, batch: Vec<Job>) -> bool {
        let start = Instant::now();
        let Some(estimates) = estimate_frames(estimator, &batch) else {
            for job in batch {
                self.fail(job, QueueError::Crashed);
            }
            return false;
        };
        let batch_size = batch.len();
        // Images that were left half way would make it look quicker than it is.
        if estimates.iter().all(Result::is_ok) {
            self.pace.record(batch_size, start.elapsed());
        }
        for (job, estimate) in batch.into_iter().zip(estimates) {
            match estimate {
                Ok(estimate) => {
                    Stats::count(&self.stats.worked);
                    job.answer(estimate, batch_size);
                }
                Err(EstimateError::Abandoned(why)) => self.abandon(job, why),
                Err(error) => self.fail(job, error.into()),
            }
        }
        true
    }

    fn measure(&self, estimator: &mut Estimator, job: Job) -> bool {
        let Task::Reference { object, region, .. } = &job.task else { return true };
        if let Err(why) = job.abandoned() {
            self.abandon(job, why);
            return true;
        }
        let image = &job.pixels.image;
        let measured = || estimator.measure(object, image, &job.camera, *region);
        let measured = catch_unwind(AssertUnwindSafe(measured));
        let sound = measured.is_ok();
        match measured {
            Ok(Ok(located)) => {
                Stats::count(&self.stats.worked);
                job.located(located);
            }
            Ok(Err(error)) => self.fail(job, error.into()),
            Err(_) => self.fail(job, QueueError::Crashed),
        }
        sound
    }

    /// An error is an answer, too.
    fn fail(&self, job: Job, error: QueueError) {
        Stats::count(&self.stats.worked);
        job.fail(error);
    }

    /// Nobody waits for it any more, or in vain.
    fn abandon(&self, job: Job, why: Abandoned) {
        self.stats.abandon(why);
        job.fail(why.into());
    }
}

/// `None` where it panicked.
fn estimate_frames(estimator: &mut Estimator, batch: &[Job]) -> Option<Vec<Result<Estimate, EstimateError>>> {
    let checks: Vec<_> = batch.iter().map(|job| || job.abandoned()).collect();
    let mut frames: Vec<Frame<'_>> = Vec::with_capacity(batch.len());
    for (job, abandoned) in batch.iter().zip(&checks) {
        let (selection, guide) = match &job.task {
            Task::Poses { selection, guide, .. } => (selection, guide.as_ref()),
            Task::Reference { .. } => (&Selection::ALL, None),
        };
        frames.push(Frame { image: &job.pixels.image, camera: &job.camera, selection, guide, abandoned });
    }
    catch_unwind(AssertUnwindSafe(|| estimator.estimate_all(&frames))).ok()
}
