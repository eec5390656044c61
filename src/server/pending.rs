//! A request on its way to its answer.

use std::sync::Arc;
use std::time::Instant;

use tracing::Span;

use super::service::{Answered, Service};

/// What became of a request whose caller left before it was answered.
const CANCELLED: &str = "cancelled";

/// Counts a request once, with its outcome, and writes its line in the log: also where its caller leaves before the answer.
pub(super) struct Pending {
    service: Arc<Service>,
    protocol: &'static str,
    route: String,
    for_poses: bool,
    span: Span,
    start: Instant,
    open: bool,
}

impl Pending {
    /// `for_poses` where it asks for poses, and so is part of what `/v1/status` tells of the last minute.
    pub(super) fn new(
        service: &Arc<Service>,
        protocol: &'static str,
        route: impl Into<String>,
        for_poses: bool,
        span: Span,
    ) -> Self {
        let (service, route) = (Arc::clone(service), route.into());
        Self { service, protocol, route, for_poses, span, start: Instant::now(), open: true }
    }

    /// It is answered: with `ok`, or with a failure's name.
    pub(super) fn answered(mut self, outcome: &'static str, status: Option<u16>) {
        self.count(outcome, status);
    }

    /// It is counted elsewhere.
    pub(super) fn forget(mut self) {
        self.open = false;
    }

    fn count(&mut self, outcome: &'static str, status: Option<u16>) {
        self.open = false;
        let (duration, route, for_poses) = (self.start.elapsed(), self.route.as_str(), self.for_poses);
        self.service.answered(&Answered { protocol: self.protocol, route, for_poses, outcome, duration });
        let ms = u64::try_from(duration.as_millis()).unwrap_or(u64::MAX);
        tracing::info!(parent: &self.span, status, outcome, ms);
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        if self.open {
            self.count(CANCELLED, None);
        }
    }
}
