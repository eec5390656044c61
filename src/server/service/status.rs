//! How the server is doing, for people and pages; `/metrics` is for scrapers.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::memory::resident_bytes;
use super::recent::LastMinute;
use super::state::Service;
use crate::model::Library;

/// One moment of a server.
#[derive(Clone, Debug)]
pub(crate) struct StatusSnapshot {
    /// Why no request should come, where there is a reason.
    pub trouble: Option<&'static str>,
    pub images: usize,
    pub body_bytes: usize,
    pub ready_workers: usize,
    pub worker_restarts: u64,
    pub last_minute: LastMinute,
    pub resident_bytes: u64,
    pub bound_bytes: u64,
    pub library: Arc<Library>,
}

impl Service {
    pub(crate) fn status(&self) -> StatusSnapshot {
        let (stats, admission) = (self.queue.stats(), self.queue.admission());
        StatusSnapshot {
            trouble: self.serves().err(),
            images: admission.images(),
            body_bytes: admission.bytes(),
            ready_workers: stats.ready_workers.load(Ordering::Relaxed),
            worker_restarts: stats.worker_restarts.load(Ordering::Relaxed),
            last_minute: self.recent.last_minute(),
            resident_bytes: resident_bytes(),
            bound_bytes: self.memory.bound().total_bytes(),
            library: Arc::clone(&self.catalogue().library),
        }
    }
}
