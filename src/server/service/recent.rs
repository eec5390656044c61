//! The requests of the last minute.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const WINDOW: Duration = Duration::from_mins(1);
/// Beyond this rate the window is shorter than a minute.
const MOST: usize = 8192;

/// Outcomes and durations, newest last.
#[derive(Default)]
pub(super) struct Recent(Mutex<VecDeque<Request>>);

#[derive(Clone, Copy)]
struct Request {
    at: Instant,
    outcome: &'static str,
    duration: Duration,
}

/// What the last minute was like.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct LastMinute {
    pub outcomes: BTreeMap<&'static str, usize>,
    /// Answered with success, per second.
    pub rate: f64,
    /// Of the successes; `None` where there was none.
    pub latency: Option<Latency>,
}

/// Quantiles of a duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Latency {
    pub p50: Duration,
    pub p90: Duration,
    pub p99: Duration,
}

impl Recent {
    pub(super) fn add(&self, outcome: &'static str, duration: Duration) {
        let at = Instant::now();
        // Whole entries are pushed and popped: valid whoever panicked beside it.
        let mut requests = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if requests.len() == MOST {
            requests.pop_front();
        }
        requests.push_back(Request { at, outcome, duration });
    }

    pub(super) fn last_minute(&self) -> LastMinute {
        let mut requests = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        while requests.front().is_some_and(|request| now - request.at > WINDOW) {
            requests.pop_front();
        }
        let since = requests.front().filter(|_| requests.len() == MOST).map_or(WINDOW, |oldest| now - oldest.at);
        let mut outcomes = BTreeMap::new();
        for request in requests.iter() {
            *outcomes.entry(request.outcome).or_insert(0) += 1;
        }
        let mut durations: Vec<Duration> =
            requests.iter().filter(|request| request.outcome == "ok").map(|request| request.duration).collect();
        drop(requests);
        durations.sort_unstable();
        let rate = durations.len() as f64 / since.as_secs_f64().max(1e-3);
        LastMinute { outcomes, rate, latency: Latency::of(&durations) }
    }
}

impl Latency {
    fn of(sorted: &[Duration]) -> Option<Self> {
        let quantile = |percent: usize| sorted.get((sorted.len() * percent / 100).min(sorted.len().saturating_sub(1)));
        Some(Self { p50: *quantile(50)?, p90: *quantile(90)?, p99: *quantile(99)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_of_the_successes() {
        let recent = Recent::default();
        assert_eq!(recent.last_minute().latency, None);
        for milliseconds in 1..=100 {
            recent.add("ok", Duration::from_millis(milliseconds));
        }
        recent.add("queue_full", Duration::from_secs(9));
        let last = recent.last_minute();
        let latency = last.latency.unwrap();
        assert_eq!([latency.p50, latency.p90, latency.p99], [51, 91, 100].map(Duration::from_millis));
        assert_eq!((last.outcomes["ok"], last.outcomes["queue_full"]), (100, 1));
        assert!((last.rate - 100.0 / 60.0).abs() < 1e-9);
    }

    #[test]
    fn the_oldest_make_room() {
        let recent = Recent::default();
        for _ in 0..MOST + 10 {
            recent.add("ok", Duration::ZERO);
        }
        assert_eq!(recent.last_minute().outcomes["ok"], MOST);
    }
}
