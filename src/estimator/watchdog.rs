//! Takes workers out that do not come back from an image: a network may hang, and everybody behind it would wait in vain.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use super::stats::Stats;

/// What a worker does at the moment.
#[derive(Debug, Default)]
pub(super) struct Activity(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// While it works on a batch.
    since: Option<Instant>,
    /// What runs now.
    networks: Vec<String>,
    /// What ran when it was taken out.
    hung: Option<String>,
}

/// A network runs until this is dropped.
pub(super) struct Running<'a> {
    activity: &'a Activity,
    network: String,
}

impl Activity {
    pub(super) fn begin(&self) {
        self.with(|state| state.since = Some(Instant::now()));
    }

    #[must_use]
    pub(super) fn runs(&self, network: &str) -> Running<'_> {
        self.with(|state| state.networks.push(network.to_owned()));
        Running { activity: self, network: network.to_owned() }
    }

    /// The batch is answered. A worker that was taken out is back.
    pub(super) fn end(&self, worker: &str, stats: &Stats) {
        self.with(|state| {
            state.since = None;
            if let Some(hung) = state.hung.take() {
                stats.ready_workers.fetch_add(1, Ordering::Relaxed);
                stats.lost_workers.fetch_sub(1, Ordering::Relaxed);
                tracing::warn!("{worker} is back: {hung} has ended after all");
            }
        });
    }

    fn take_out(&self, worker: &str, limit: Duration, stats: &Stats) {
        self.with(|state| {
            if state.hung.is_some() || state.since.is_none_or(|since| since.elapsed() <= limit) {
                return;
            }
            let network = if state.networks.is_empty() { "no network".into() } else { state.networks.join(", ") };
            state.hung = Some(network.clone());
            stats.ready_workers.fetch_sub(1, Ordering::Relaxed);
            stats.lost_workers.fetch_add(1, Ordering::Relaxed);
            Stats::count(&stats.worker_timeouts);
            tracing::error!(
                "{worker} is taken out: its images take longer than {limit:?} ('worker_timeout_ms'), and it is still in \
                 {network}; if it does not come back, restart the server, and check that model"
            );
        });
    }

    fn with<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        // Each field is valid by itself, whoever panicked beside it.
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.activity.with(|state| {
            if let Some(place) = state.networks.iter().position(|network| *network == self.network) {
                state.networks.swap_remove(place);
            }
        });
    }
}

/// Watches workers, given by their names, until the last of them has ended.
pub(super) fn watch(limit: Duration, workers: Vec<(String, Weak<Activity>)>, stats: Arc<Stats>) -> std::io::Result<()> {
    let pause = (limit / 4).clamp(Duration::from_millis(2), Duration::from_secs(1));
    let look = move || {
        loop {
            let mut left = false;
            for (worker, activity) in &workers {
                if let Some(activity) = activity.upgrade() {
                    left = true;
                    activity.take_out(worker, limit, &stats);
                }
            }
            if !left {
                return;
            }
            std::thread::sleep(pause);
        }
    };
    std::thread::Builder::new().name("watchdog".into()).spawn(look).map(drop)
}
