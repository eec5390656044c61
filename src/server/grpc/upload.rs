//! Messages under a lease: each states its length first, and room is asked for before the rest is read.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::Frame;
use tonic::Status;

use super::call::Call;
use super::route::Route;
use crate::server::body::Stall;
use crate::server::service::{Failure, FailureKind, Service};

/// Messages of health checks and reflection are short.
const MAX_OTHER_BYTES: usize = 16 * 1024;

/// A call's body: its messages are counted as they are announced, and come in their time.
pub(super) struct Messages {
    body: Body,
    call: Call,
    route: Route,
    service: Arc<Service>,
    /// Of a message, bytes.
    limit: usize,
    frame: Prefixed,
    /// Whether anything has come.
    started: bool,
    /// Since the last bytes.
    pause: Stall,
    /// Since the message began.
    message: Stall,
}

impl Messages {
    pub(super) fn body(body: Body, call: Call, route: Route, service: &Arc<Service>, limit: usize) -> Body {
        Body::new(Self {
            body,
            call,
            route,
            service: Arc::clone(service),
            limit,
            frame: Prefixed::default(),
            started: false,
            pause: Stall::new(service.limits.body_timeout),
            message: Stall::new(service.limits.timeout),
        })
    }

    fn count(&mut self, mut data: &[u8]) -> Result<(), Failure> {
        self.started |= !data.is_empty();
        while let Some(length) = self.frame.next_length(&mut data) {
            self.message.reset();
            if !self.route.is_ours() && length > MAX_OTHER_BYTES {
                let message = format!("the message is larger than {MAX_OTHER_BYTES} bytes");
                return Err(Failure::new(FailureKind::TooLarge, message));
            }
            // Larger ones are refused by the decoder, unread.
            if length <= self.limit {
                let request = self.call.deadline.filter(|_| self.route.is_single() && self.route.is_for_poses());
                self.service.admit_message(&self.call.body, length, request)?;
                self.call.announce(length);
            }
        }
        Ok(())
    }

    /// Ends the call before its handler has it.
    fn refuse(&self, failure: Failure) -> Status {
        self.call.failed(failure).into()
    }

    /// Whether the client owes us something now: the first message, the rest of one, or the end of a call that has but one.
    /// Between the frames of a stream it may be silent.
    fn is_due(&self) -> bool {
        self.frame.is_inside() || self.route.is_single() || (!self.started && !self.route.is_ours())
    }

    fn stall(&mut self, context: &mut Context<'_>) -> Poll<Failure> {
        if !self.is_due() {
            return Poll::Pending;
        }
        if self.pause.poll(context).is_ready() {
            return Poll::Ready(stalled());
        }
        if self.frame.is_inside() && self.message.poll(context).is_ready() {
            return Poll::Ready(slow());
        }
        Poll::Pending
    }
}

impl HttpBody for Messages {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        match Pin::new(&mut self.body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                self.pause.reset();
                let counted = self.count(frame.data_ref().map_or(&[], AsRef::as_ref));
                Poll::Ready(Some(counted.map(|()| frame).map_err(|failure| self.refuse(failure))))
            }
            Poll::Ready(Some(Err(error))) => Poll::Ready(Some(Err(Status::from_error(error.into())))),
            Poll::Ready(None) => Poll::Ready(None),
            Poll::Pending => self.stall(context).map(|failure| Some(Err(self.refuse(failure)))),
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }
}

fn slow() -> Failure {
    Failure::new(FailureKind::TimedOut, "the message took longer than 'timeout_ms' to arrive; send it faster, or less")
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
