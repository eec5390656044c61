//! The threads behind the queue: one decodes and forms batches, the others own the networks.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};
use thiserror::Error;

use super::answer::{Abandoned, Estimate, EstimateError, Selection};
use super::job::{Answer, Job, QueueError, Task};
use super::pipeline::{Estimator, Frame};
use super::queue::{QueueConfig, QueueStats, count};
use crate::model::RuntimeError;
use crate::vision::{Decoded, Image, decode};

/// Workers that cannot be started.
#[derive(Debug, Error)]
pub enum StartError {
    #[error("the system gives no thread: {0}")]
    Thread(#[from] std::io::Error),
    #[error(transparent)]
    Network(#[from] RuntimeError),
    #[error("the networks do not run: {0}")]
    WarmUp(#[from] EstimateError),
    #[error("a worker panicked while it loaded the networks")]
    Panicked,
}

type Make = Arc<dyn Fn() -> Result<Estimator, RuntimeError> + Send + Sync>;

/// A job with its pixels.
struct Prepared {
    job: Job,
    decoded: Decoded,
    queued: Duration,
    decode: Duration,
}

pub(super) fn start(
    config: QueueConfig,
    jobs: Receiver<Job>,
    make: &Make,
    stats: &Arc<QueueStats>,
) -> Result<(), StartError> {
    // Without room: while the workers are busy, one batch is prepared and waits, and the next ones grow behind it.
    let (batches, batch) = crossbeam_channel::bounded(0);
    let (started, starts) = crossbeam_channel::unbounded();
    for index in 0..config.workers {
        let (make, stats, batch, started) = (Arc::clone(make), Arc::clone(stats), batch.clone(), started.clone());
        let thread = std::thread::Builder::new().name(format!("worker-{index}"));
        thread.spawn(move || work(&make, &batch, &started, &stats))?;
    }
    drop((batch, started));
    for _ in 0..config.workers {
        starts.recv().map_err(|_| StartError::Panicked)??;
    }
    let thread = std::thread::Builder::new().name("prepare".into());
    let stats = Arc::clone(stats);
    thread.spawn(move || prepare(config, &jobs, &batches, &stats))?;
    Ok(())
}

/// Decodes what waits and hands it on in batches.
fn prepare(config: QueueConfig, jobs: &Receiver<Job>, batches: &Sender<Vec<Prepared>>, stats: &QueueStats) {
    while let Ok(first) = jobs.recv() {
        let closes = Instant::now() + config.batch_delay;
        let mut batch = Vec::new();
        let mut next = Some(first);
        while let Some(job) = next {
            batch.extend(prepare_one(job, &config, stats));
            let room = batch.len() < config.max_batch;
            next = room.then(|| jobs.recv_deadline(closes).or_else(|_| jobs.try_recv()).ok()).flatten();
        }
        if !batch.is_empty() && batches.send(batch).is_err() {
            return; // no worker is left; their callers learn it from the dropped replies
        }
    }
}

fn prepare_one(mut job: Job, config: &QueueConfig, stats: &QueueStats) -> Option<Prepared> {
    if let Err(why) = job.wanted() {
        abandon(job, why, stats);
        return None;
    }
    let (queued, start) = (job.arrived.elapsed(), Instant::now());
    // Decoders are fed by strangers.
    let image = Image::Encoded(std::mem::take(&mut job.image).into());
    let decoded = catch_unwind(AssertUnwindSafe(|| decode(&image, &config.decode)));
    match decoded {
        Ok(Ok(decoded)) => Some(Prepared { job, decoded, queued, decode: start.elapsed() }),
        Ok(Err(error)) => {
            job.fail(error.into());
            None
        }
        Err(_) => {
            tracing::error!("decoding an image panicked; it is answered with an error");
            job.fail(QueueError::Crashed);
            None
        }
    }
}

/// A worker's life: networks, batches, and after a panic new networks.
fn work(make: &Make, batches: &Receiver<Vec<Prepared>>, started: &Sender<Result<(), StartError>>, stats: &QueueStats) {
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
    while let Ok(batch) = batches.recv() {
        count(&stats.batches);
        if answer(&mut estimator, batch, stats) {
            continue;
        }
        stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
        count(&stats.worker_restarts);
        tracing::error!("estimating panicked; its images are answered with an error, the networks are loaded again");
        estimator = match make() {
            Ok(estimator) => estimator,
            Err(error) => return tracing::error!(%error, "a worker ends: its networks cannot be loaded again"),
        };
        stats.ready_workers.fetch_add(1, Ordering::Relaxed);
    }
    stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
}

/// Answers a batch; false where it panicked.
fn answer(estimator: &mut Estimator, batch: Vec<Prepared>, stats: &QueueStats) -> bool {
    let (poses, references): (Vec<_>, Vec<_>) =
        batch.into_iter().partition(|prepared| matches!(prepared.job.task, Task::Poses { .. }));
    let mut sound = poses.is_empty() || estimate(estimator, poses, stats);
    for prepared in references {
        sound = sound && measure(estimator, prepared, stats);
    }
    sound
}

fn estimate(estimator: &mut Estimator, batch: Vec<Prepared>, stats: &QueueStats) -> bool {
    let Some(estimates) = estimate_frames(estimator, &batch) else {
        for prepared in batch {
            prepared.job.fail(QueueError::Crashed);
        }
        return false;
    };
    let batch_size = batch.len();
    for (prepared, estimate) in batch.into_iter().zip(estimates) {
        match estimate {
            Ok(estimate) => {
                count(&stats.worked);
                prepared.answer(estimate, batch_size);
            }
            Err(EstimateError::Abandoned(why)) => abandon(prepared.job, why, stats),
            Err(error) => prepared.job.fail(error.into()),
        }
    }
    true
}

/// `None` where it panicked.
fn estimate_frames(estimator: &mut Estimator, batch: &[Prepared]) -> Option<Vec<Result<Estimate, EstimateError>>> {
    let checks: Vec<_> = batch.iter().map(|prepared| || prepared.job.wanted()).collect();
    let mut frames: Vec<Frame<'_>> = Vec::with_capacity(batch.len());
    for (prepared, wanted) in batch.iter().zip(&checks) {
        let selection = match &prepared.job.task {
            Task::Poses { selection, .. } => selection,
            Task::Reference { .. } => &Selection::ALL,
        };
        frames.push(Frame { image: &prepared.decoded.image, camera: &prepared.job.camera, selection, wanted });
    }
    catch_unwind(AssertUnwindSafe(|| estimator.estimate_all(&frames))).ok()
}

fn measure(estimator: &mut Estimator, prepared: Prepared, stats: &QueueStats) -> bool {
    let Prepared { job, decoded, .. } = prepared;
    let Task::Reference { object, region, .. } = &job.task else { return true };
    if let Err(why) = job.wanted() {
        abandon(job, why, stats);
        return true;
    }
    let measured = catch_unwind(AssertUnwindSafe(|| estimator.measure(object, &decoded.image, &job.camera, *region)));
    match measured {
        Ok(Ok(solved)) => {
            count(&stats.worked);
            let Job { task, place, .. } = job;
            drop(place);
            if let Task::Reference { reply, .. } = task {
                drop(reply.send(Ok(solved)));
            }
            true
        }
        Ok(Err(error)) => {
            job.fail(error.into());
            true
        }
        Err(_) => {
            job.fail(QueueError::Crashed);
            false
        }
    }
}

/// Nobody waits for it any more.
fn abandon(job: Job, why: Abandoned, stats: &QueueStats) {
    stats.count_abandoned(why);
    job.fail(why.into());
}

impl Prepared {
    fn answer(self, estimate: Estimate, batch_size: usize) {
        let Self { job, decoded: Decoded { image, exif }, queued, decode } = self;
        let Job { task, arrived, place, .. } = job;
        drop(place);
        let Task::Poses { keep_image, reply, .. } = task else { return };
        let answer = Answer {
            estimate,
            exif,
            image: keep_image.then_some(image),
            batch_size,
            queued,
            decode,
            total: arrived.elapsed(),
        };
        // A caller that has left meanwhile is no fault.
        drop(reply.send(Ok(answer)));
    }
}
