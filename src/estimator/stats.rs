//! What has gone through the estimator, for those who watch it.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use super::answer::Abandoned;

/// Counters since the start.
#[derive(Debug, Default)]
pub struct Stats {
    pub admitted: AtomicU64,
    /// Bodies and images that found no room.
    pub refused: AtomicU64,
    /// Answered by a worker.
    pub worked: AtomicU64,
    pub expired: AtomicU64,
    pub cancelled: AtomicU64,
    /// Images that could not be decoded.
    pub undecodable: AtomicU64,
    pub batches: AtomicU64,
    pub worker_restarts: AtomicU64,
    /// Times that a worker was taken out because its images took too long.
    pub worker_timeouts: AtomicU64,
    /// Workers that can take a batch.
    pub ready_workers: AtomicUsize,
    /// Workers that have ended or hang: nobody waits for them.
    pub lost_workers: AtomicUsize,
}

impl Stats {
    /// One more found no room.
    pub fn refuse(&self) {
        Self::count(&self.refused);
    }

    pub(super) fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn abandon(&self, why: Abandoned) {
        Self::count(match why {
            Abandoned::Expired => &self.expired,
            Abandoned::Cancelled => &self.cancelled,
        });
    }
}
