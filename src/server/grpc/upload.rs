//! Messages under a lease: each states its length first, and room is asked for before the rest is read.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::{Body, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use bytes::Bytes;
use http_body::Frame;
use tokio::sync::Semaphore;
use tonic::Status;
use tracing::Instrument as _;

use crate::estimator::BodyLease;
use crate::server::body::{Held, Stall};
use crate::server::observe::span;
use crate::server::service::{Answered, Failure, FailureKind, Service};

/// The room of a call's messages, for its handler to pass on.
#[derive(Clone)]
pub(super) struct Lease {
    pub body: Arc<BodyLease>,
    /// Lengths of messages that were announced and not taken yet.
    announced: Arc<Mutex<VecDeque<usize>>>,
}

impl Lease {
    /// The room of the next message of a stream: all that was announced of it, known to us or not.
    pub(super) fn next_message(&self) -> BodyLease {
        let length = self.announced.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
        self.body.split(length.unwrap_or(0))
    }
}

/// What calls are admitted by.
#[derive(Clone)]
pub(super) struct Admitting {
    service: Arc<Service>,
    /// Of a message, bytes.
    limit: usize,
    calls: Arc<Semaphore>,
}

impl Admitting {
    pub(super) fn new(service: &Arc<Service>, limit: usize) -> Self {
        Self { service: Arc::clone(service), limit, calls: Arc::new(Semaphore::new(MAX_CALLS)) }
    }
}

const ROUTES: [&str; 3] = ["Estimate", "EstimateStream", "ListObjects"];
const OTHER: &str = "other";

/// Open calls on all connections; each takes memory even if nothing comes.
pub(super) const MAX_CALLS: usize = 2048;
/// Messages of health checks and reflection are short.
const MAX_OTHER_BYTES: usize = 16 * 1024;

/// Counts a call's messages as they are announced.
pub(super) async fn admit(State(admitting): State<Admitting>, request: Request, next: Next) -> Response {
    let called = request.uri().path().strip_prefix("/posed.v1.PoseService/");
    // Bounded: what is no call of ours is one label.
    let route = ROUTES.into_iter().find(|route| Some(*route) == called).unwrap_or(OTHER);
    let span = span("grpc", &request, route);
    let Ok(call) = Arc::clone(&admitting.calls).try_acquire_owned() else {
        let message = format!("{MAX_CALLS} calls are open already; try again in a moment");
        return Status::from(Failure::new(FailureKind::QueueFull, message)).into_http();
    };
    let lease = Lease { body: admitting.service.lease(), announced: Arc::default() };
    let (mut parts, body) = request.into_parts();
    parts.extensions.insert(lease.clone());
    let stall = Stall::new(admitting.service.limits.body_timeout);
    let messages = Messages {
        body,
        lease: lease.clone(),
        admitting,
        route,
        start: Instant::now(),
        frame: Prefixed::default(),
        stall,
    };
    let response = next.run(Request::from_parts(parts, Body::new(messages))).instrument(span).await;
    // Until the answer has left: a client that does not read it has no room for more.
    response.map(|body| Held::body(body, (lease, call)))
}

/// A call's body.
struct Messages {
    body: Body,
    lease: Lease,
    admitting: Admitting,
    route: &'static str,
    start: Instant,
    frame: Prefixed,
    stall: Stall,
}

impl Messages {
    fn count(&mut self, mut data: &[u8]) -> Result<(), Status> {
        while let Some(length) = self.frame.next_length(&mut data) {
            if self.route == OTHER && length > MAX_OTHER_BYTES {
                let message = format!("the message is larger than {MAX_OTHER_BYTES} bytes");
                return Err(self.refuse(Failure::new(FailureKind::TooLarge, message)));
            }
            // Larger ones are refused by the decoder, unread.
            if length <= self.admitting.limit {
                let admitted = self.admitting.service.admit_message(&self.lease.body, length, self.is_single());
                admitted.map_err(|failure| self.refuse(failure))?;
                self.lease.announced.lock().unwrap_or_else(PoisonError::into_inner).push_back(length);
            }
        }
        Ok(())
    }

    /// Ends the call before its handler has it.
    fn refuse(&self, failure: Failure) -> Status {
        let (outcome, duration) = (failure.kind.name(), self.start.elapsed());
        let (route, for_poses) = (self.route, true);
        self.admitting.service.answered(&Answered { protocol: "grpc", route, for_poses, outcome, duration });
        failure.into()
    }

    /// One message, and the call is complete.
    fn is_single(&self) -> bool {
        self.route == "Estimate" || self.route == "ListObjects"
    }

    /// Whether the client owes us something now: the rest of a message, or the end of a call that has but one. Between the
    /// frames of a stream it may be silent.
    fn is_due(&self) -> bool {
        self.frame.is_inside() || self.is_single()
    }
}

impl HttpBody for Messages {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        match Pin::new(&mut self.body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                self.stall.reset();
                let counted = self.count(frame.data_ref().map_or(&[], AsRef::as_ref));
                Poll::Ready(Some(counted.map(|()| frame)))
            }
            Poll::Ready(Some(Err(error))) => Poll::Ready(Some(Err(Status::from_error(error.into())))),
            Poll::Ready(None) => Poll::Ready(None),
            Poll::Pending if self.is_due() => self.stall.poll(context).map(|()| Some(Err(self.refuse(stalled())))),
            Poll::Pending => Poll::Pending,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }
}

fn stalled() -> Failure {
    Failure::new(FailureKind::TimedOut, "the message stalled for longer than 'body_timeout_ms'; send it without pauses")
}

/// Follows gRPC's framing: a flag, four bytes of length, the message.
#[derive(Default)]
struct Prefixed {
    prefix: [u8; 5],
    /// Bytes of the prefix that are there.
    have: usize,
    /// Bytes of the message that are still to come.
    left: usize,
}

impl Prefixed {
    /// Consumes data up to the end of the next prefix, and gives the length that it states; all of it, where there is none.
    fn next_length(&mut self, data: &mut &[u8]) -> Option<usize> {
        let skipped = self.left.min(data.len());
        self.left -= skipped;
        *data = &data[skipped..];
        let taken = (self.prefix.len() - self.have).min(data.len());
        self.prefix[self.have..self.have + taken].copy_from_slice(&data[..taken]);
        self.have += taken;
        *data = &data[taken..];
        if self.have < self.prefix.len() {
            return None;
        }
        let [_, length @ ..] = self.prefix;
        self.have = 0;
        self.left = u32::from_be_bytes(length) as usize;
        Some(self.left)
    }

    fn is_inside(&self) -> bool {
        self.have > 0 || self.left > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// However the bytes are cut: every message's length is found, once.
        #[test]
        fn lengths_are_found(lengths in prop::collection::vec(0..300u32, 0..6), cuts in prop::collection::vec(1..40usize, 1..9)) {
            let message = |length: &u32| [&[0], &length.to_be_bytes()[..], &vec![7; *length as usize]].concat();
            let stream: Vec<u8> = lengths.iter().flat_map(message).collect();
            let (mut frame, mut found, mut rest) = (Prefixed::default(), Vec::new(), stream.as_slice());
            for cut in cuts.iter().cycle() {
                let (mut chunk, later) = rest.split_at(rest.len().min(*cut));
                while let Some(length) = frame.next_length(&mut chunk) {
                    found.push(length);
                }
                rest = later;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(found, lengths.iter().map(|length| *length as usize).collect::<Vec<_>>());
            prop_assert!(!frame.is_inside());
        }
    }
}
