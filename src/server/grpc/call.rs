//! What is known of a call, for its handler and for whoever counts it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;

use tonic::Request;

use crate::estimator::BodyLease;
use crate::server::service::{Failure, FailureKind};

/// A call that was admitted. Clones are one.
#[derive(Clone)]
pub(super) struct Call {
    /// The room of its messages.
    pub body: Arc<BodyLease>,
    /// When its time is over, where it has one: every call but a stream does.
    pub deadline: Option<Instant>,
    /// Lengths of messages that were announced and not taken yet.
    announced: Arc<Mutex<VecDeque<usize>>>,
    /// Why it failed, where that is known better than its code says.
    failed: Arc<OnceLock<FailureKind>>,
}

impl Call {
    pub(super) fn new(body: Arc<BodyLease>, deadline: Option<Instant>) -> Self {
        Self { body, deadline, announced: Arc::default(), failed: Arc::default() }
    }

    /// What `admit` has put into a request.
    pub(super) fn of<T>(request: &Request<T>) -> Result<Self, Failure> {
        let call = request.extensions().get::<Self>().cloned();
        call.ok_or_else(|| Failure::new(FailureKind::Internal, "the call was not admitted"))
    }

    /// A message of this length has been announced.
    pub(super) fn announce(&self, length: usize) {
        self.announced.lock().unwrap_or_else(PoisonError::into_inner).push_back(length);
    }

    /// The room of the next message of a stream: all that was announced of it, known to us or not.
    pub(super) fn next_message(&self) -> BodyLease {
        let length = self.announced.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
        self.body.split(length.unwrap_or(0))
    }

    /// Remembers why the call fails. The first reason counts.
    pub(super) fn failed(&self, failure: Failure) -> Failure {
        let _ = self.failed.set(failure.kind);
        failure
    }

    pub(super) fn failure(&self) -> Option<FailureKind> {
        self.failed.get().copied()
    }
}
