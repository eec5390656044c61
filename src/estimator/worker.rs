//! The threads that own the networks: they take what waits, a batch at a time, and answer it.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};
use thiserror::Error;

use super::answer::{Abandoned, Estimate, EstimateError, Selection};
use super::job::{Job, QueueError, Task};
use super::pipeline::{Estimator, Frame};
use super::stats::Stats;
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

/// Starts the workers and comes back once each of them is warmed up. They end with the last sender of `jobs`.
pub(super) fn start(
    workers: usize,
    batching: Batching,
    jobs: &Receiver<Job>,
    make: &Make,
    stats: &Arc<Stats>,
) -> Result<(), StartError> {
    let (started, starts) = crossbeam_channel::unbounded();
    for index in 0..workers {
        let (make, stats, jobs, started) = (Arc::clone(make), Arc::clone(stats), jobs.clone(), started.clone());
        let thread = std::thread::Builder::new().name(format!("worker-{index}"));
        thread.spawn(move || work(&make, batching, &jobs, &started, &stats))?;
    }
    drop(started);
    for _ in 0..workers {
        starts.recv().map_err(|_| StartError::Panicked)??;
    }
    Ok(())
}

/// A worker's life: networks, batches, and after a panic new networks.
fn work(
    make: &Make,
    batching: Batching,
    jobs: &Receiver<Job>,
    started: &Sender<Result<(), StartError>>,
    stats: &Stats,
) {
    let first = (|| {
        let mut estimator = make()?;
        estimator.warm_up()?;
        Ok(estimator)
    })();
    let mut estimator = match first {
        Ok(estimator) => estimator,
        Err(error) => return drop(started.send(Err(error))),
    };
    stats.ready_workers.fetch_add(1, Ordering::Relaxed);
    // The receiver waits for every worker.
    let _ = started.send(Ok(()));
    while let Ok(first) = jobs.recv() {
        let batch = batching.gather(first, jobs, stats);
        if batch.is_empty() {
            continue;
        }
        Stats::count(&stats.batches);
        if answer(&mut estimator, batch, stats) {
            continue;
        }
        stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
        Stats::count(&stats.worker_restarts);
        tracing::error!("a worker panicked: its images get an error, and it reloads its networks");
        estimator = match make() {
            Ok(estimator) => estimator,
            Err(error) => return tracing::error!(%error, "a worker ends: it cannot reload its networks"),
        };
        stats.ready_workers.fetch_add(1, Ordering::Relaxed);
    }
    stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
}

impl Batching {
    /// What waits, and what comes soon, as far as somebody waits for it.
    fn gather(self, first: Job, jobs: &Receiver<Job>, stats: &Stats) -> Vec<Job> {
        let closes = Instant::now() + self.delay;
        let mut batch = Vec::new();
        let mut next = Some(first);
        while let Some(job) = next {
            match job.abandoned() {
                Ok(()) => batch.push(job),
                Err(why) => abandon(job, why, stats),
            }
            let room = batch.len() < self.most;
            next = room.then(|| jobs.recv_deadline(closes).or_else(|_| jobs.try_recv()).ok()).flatten();
        }
        batch
    }
}

/// Answers a batch; false where it panicked.
fn answer(estimator: &mut Estimator, batch: Vec<Job>, stats: &Stats) -> bool {
    let (poses, references): (Vec<_>, Vec<_>) =
        batch.into_iter().partition(|job| matches!(job.task, Task::Poses { .. }));
    let mut sound = poses.is_empty() || estimate(estimator, poses, stats);
    for job in references {
        sound = sound && measure(estimator, job, stats);
    }
    sound
}

fn estimate(estimator: &mut Estimator, batch: Vec<Job>, stats: &Stats) -> bool {
    let Some(estimates) = estimate_frames(estimator, &batch) else {
        for job in batch {
            job.fail(QueueError::Crashed);
        }
        return false;
    };
    let batch_size = batch.len();
    for (job, estimate) in batch.into_iter().zip(estimates) {
        match estimate {
            Ok(estimate) => {
                Stats::count(&stats.worked);
                job.answer(estimate, batch_size);
            }
            Err(EstimateError::Abandoned(why)) => abandon(job, why, stats),
            Err(error) => job.fail(error.into()),
        }
    }
    true
}

/// `None` where it panicked.
fn estimate_frames(estimator: &mut Estimator, batch: &[Job]) -> Option<Vec<Result<Estimate, EstimateError>>> {
    let checks: Vec<_> = batch.iter().map(|job| || job.abandoned()).collect();
    let mut frames: Vec<Frame<'_>> = Vec::with_capacity(batch.len());
    for (job, abandoned) in batch.iter().zip(&checks) {
        let selection = match &job.task {
            Task::Poses { selection, .. } => selection,
            Task::Reference { .. } => &Selection::ALL,
        };
        frames.push(Frame { image: &job.pixels.image, camera: &job.camera, selection, abandoned });
    }
    catch_unwind(AssertUnwindSafe(|| estimator.estimate_all(&frames))).ok()
}

fn measure(estimator: &mut Estimator, job: Job, stats: &Stats) -> bool {
    let Task::Reference { object, region, .. } = &job.task else { return true };
    if let Err(why) = job.abandoned() {
        abandon(job, why, stats);
        return true;
    }
    let image = &job.pixels.image;
    let measured = catch_unwind(AssertUnwindSafe(|| estimator.measure(object, image, &job.camera, *region)));
    let sound = measured.is_ok();
    match measured {
        Ok(Ok(solved)) => {
            Stats::count(&stats.worked);
            job.solved(solved);
        }
        Ok(Err(error)) => job.fail(error.into()),
        Err(_) => job.fail(QueueError::Crashed),
    }
    sound
}

/// Nobody waits for it any more.
fn abandon(job: Job, why: Abandoned, stats: &Stats) {
    stats.abandon(why);
    job.fail(why.into());
}
