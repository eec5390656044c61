//! Messages under a lease: each states its length first, and room is asked for before the rest is read.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::{Body, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use bytes::Bytes;
use http_body::Frame;
use tonic::Status;
use tracing::Instrument as _;

use crate::estimator::BodyLease;
use crate::server::body::{Held, Stall};
use crate::server::observe::span;
use crate::server::service::{Answered, Failure, FailureKind, Service};

/// The room of a call's messages, for its handler to pass on.
#[derive(Clone)]
pub(super) struct Lease(pub Arc<BodyLease>);

/// What calls are admitted by.
#[derive(Clone)]
pub(super) struct Admitting {
    service: Arc<Service>,
    /// Of a message, bytes.
    limit: usize,
}

impl Admitting {
    pub(super) fn new(service: &Arc<Service>, limit: usize) -> Self {
        Self { service: Arc::clone(service), limit }
    }
}

const ROUTES: [&str; 3] = ["Estimate", "EstimateStream", "ListObjects"];

/// Counts a call's messages as they are announced.
pub(super) async fn admit(State(admitting): State<Admitting>, request: Request, next: Next) -> Response {
    let called = request.uri().path().strip_prefix("/posed.v1.PoseService/");
    // Bounded: what is no call of ours is one label.
    let route = ROUTES.into_iter().find(|route| Some(*route) == called).unwrap_or("other");
    let span = span("grpc", &request, route);
    let lease = match admitting.service.lease() {
        Ok(lease) => lease,
        Err(failure) => return Status::from(failure).into_http(),
    };
    let (mut parts, body) = request.into_parts();
    parts.extensions.insert(Lease(Arc::clone(&lease)));
    let stall = Stall::new(admitting.service.limits.body_timeout);
    let messages = Messages {
        body,
        lease: Arc::clone(&lease),
        admitting,
        route,
        start: Instant::now(),
        begun: false,
        frame: Prefixed::default(),
        stall,
    };
    let response = next.run(Request::from_parts(parts, Body::new(messages))).instrument(span).await;
    // Until the answer has left: a client that does not read it has no room for more.
    response.map(|body| Held::body(body, lease))
}

/// A call's body.
struct Messages {
    body: Body,
    lease: Arc<BodyLease>,
    admitting: Admitting,
    route: &'static str,
    start: Instant,
    /// Whether anything has come.
    begun: bool,
    frame: Prefixed,
    stall: Stall,
}

impl Messages {
    fn count(&mut self, mut data: &[u8]) -> Result<(), Status> {
        self.begun |= !data.is_empty();
        while let Some(length) = self.frame.next_length(&mut data) {
            // Larger ones are refused by the decoder, unread.
            if length <= self.admitting.limit {
                let admitted = self.admitting.service.admit_message(&self.lease, length, self.is_single());
                admitted.map_err(|failure| self.refuse(failure))?;
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
        self.route != "EstimateStream"
    }

    /// Whether the client owes us something now; between the frames of a stream it may be silent.
    fn is_due(&self) -> bool {
        self.frame.is_inside() || (self.is_single() && !self.begun)
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
