//! How long images take, so that what must come late is refused before it costs anything.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::admission::Refusal;

/// How much a new duration weighs against those before it.
const WEIGHT: f64 = 0.2;
/// After so long without work the last durations say little: then one image is tried, however short its time.
const STALE: Duration = Duration::from_secs(1);

/// The recent pace of the workers.
#[derive(Debug)]
pub(super) struct Pace {
    workers: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Of one image on one worker.
    image: Option<Spread>,
    last_begin: Option<Instant>,
}

/// A moving average, and the moving average of the distances from it, seconds.
#[derive(Clone, Copy, Debug)]
struct Spread {
    mean: f64,
    deviation: f64,
}

impl Pace {
    pub(super) fn new(workers: usize) -> Self {
        Self { workers, state: Mutex::default() }
    }

    /// A worker begins to work on images.
    pub(super) fn begin(&self) {
        self.with(|state| state.last_begin = Some(Instant::now()));
    }

    /// A worker has answered so many images in so long.
    pub(super) fn record(&self, images: usize, elapsed: Duration) {
        let seconds = elapsed.as_secs_f64() / images.max(1) as f64;
        self.with(|state| {
            let Spread { mean, deviation } = state.image.unwrap_or(Spread { mean: seconds, deviation: 0.0 });
            state.image = Some(Spread {
                mean: mean + WEIGHT * (seconds - mean),
                deviation: deviation + WEIGHT * ((seconds - mean).abs() - deviation),
            });
        });
    }

    /// Whether an image can be answered by its deadline, with so many ahead of it. One that finds nobody ahead, after a
    /// pause, is tried: else one slow hour would refuse hasty callers for ever.
    ///
    /// # Errors
    /// [`Refusal::Busy`] where only the others are in the way, [`Refusal::Hasty`] where the time is too short for any image.
    pub(super) fn may_come(&self, ahead: usize, deadline: Instant) -> Result<(), Refusal> {
        let (image, idle) = self.with(|state| (state.image, state.is_idle()));
        let Some(Spread { mean, deviation }) = image.filter(|_| !idle || ahead > 0) else { return Ok(()) };
        let alone = Duration::from_secs_f64(mean);
        let expected = alone.mul_f64((ahead / self.workers) as f64 + 1.0) + Duration::from_secs_f64(deviation);
        let left = deadline.saturating_duration_since(Instant::now());
        if expected <= left {
            Ok(())
        } else if alone > left {
            Err(Refusal::Hasty { alone })
        } else {
            Err(Refusal::Busy { expected })
        }
    }

    /// Whether a worker that begins now with so many images would be done too late for the first deadline of them.
    pub(super) fn would_be_late(&self, images: usize, deadline: Instant) -> bool {
        let (image, idle) = self.with(|state| (state.image, state.is_idle()));
        let expected = image.filter(|_| !idle || images > 1).map(|image| image.mean * images as f64);
        expected.is_some_and(|expected| Instant::now() + Duration::from_secs_f64(expected) > deadline)
    }

    fn with<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        // Whole values are replaced: valid whoever panicked beside it.
        change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl State {
    fn is_idle(&self) -> bool {
        self.last_begin.is_none_or(|begin| begin.elapsed() > STALE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: Duration = Duration::from_secs(100);

    fn busy(workers: usize) -> Pace {
        let pace = Pace::new(workers);
        pace.record(2, 2 * IMAGE);
        pace.begin();
        pace
    }

    fn after(images: f64) -> Instant {
        Instant::now() + IMAGE.mul_f64(images)
    }

    #[test]
    fn whoever_is_ahead_counts_and_workers_share_them() {
        for (workers, ahead, images) in [(1, 0, 1.0), (1, 3, 4.0), (2, 3, 2.0), (2, 4, 3.0)] {
            let pace = busy(workers);
            assert_eq!(pace.may_come(ahead, after(images + 0.5)), Ok(()), "{workers} {ahead}");
            let refused = pace.may_come(ahead, after(images - 0.5)).unwrap_err();
            assert_eq!(matches!(refused, Refusal::Hasty { .. }), images < 1.5, "{refused}");
        }
    }

    #[test]
    fn without_a_measurement_everybody_may_come() {
        let pace = Pace::new(1);
        assert_eq!(pace.may_come(9, Instant::now()), Ok(()));
        assert!(!pace.would_be_late(2, Instant::now()));
    }

    #[test]
    fn after_a_pause_one_is_tried() {
        let pace = Pace::new(1);
        pace.record(1, IMAGE);
        assert_eq!(pace.may_come(0, after(0.1)), Ok(()));
        assert!(!pace.would_be_late(1, after(0.1)));
        assert!(pace.may_come(1, after(0.1)).is_err() && pace.would_be_late(2, after(1.5)));
        pace.begin();
        assert!(pace.may_come(0, after(0.1)).is_err() && pace.would_be_late(1, after(0.1)));
    }

    #[test]
    fn uneven_durations_leave_a_margin() {
        let pace = busy(1);
        for _ in 0..40 {
            pace.record(1, IMAGE / 2);
            pace.record(1, IMAGE * 3 / 2);
        }
        assert!(pace.may_come(0, after(1.3)).is_err());
        assert_eq!(pace.may_come(0, after(2.0)), Ok(()));
    }
}
