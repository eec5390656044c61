//! Bodies in both directions, as every front end needs them.

use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use http_body_util::BodyExt as _;
use tokio::time::{Instant, Sleep};

/// Notices a client that sends nothing any more.
pub(super) struct Stall {
    timeout: Duration,
    sleep: Pin<Box<Sleep>>,
}

impl Stall {
    pub(super) fn new(timeout: Duration) -> Self {
        Self { timeout, sleep: Box::pin(tokio::time::sleep(timeout)) }
    }

    /// Something came.
    pub(super) fn reset(&mut self) {
        self.sleep.as_mut().reset(Instant::now() + self.timeout);
    }

    /// Ready once nothing has come for too long.
    pub(super) fn poll(&mut self, context: &mut Context<'_>) -> Poll<()> {
        self.sleep.as_mut().poll(context)
    }
}

/// Reads the rest of a body that nobody wants, so that a client which sends first and reads later comes to read its
/// answer instead of a broken pipe. Bounded in bytes and time; then the connection is closed.
pub(super) fn drain(mut body: Body, most_bytes: usize, time: Duration) {
    let Ok(runtime) = tokio::runtime::Handle::try_current() else { return };
    runtime.spawn(async move {
        let rest = async {
            let mut read = 0;
            while let Some(Ok(frame)) = body.frame().await {
                read += frame.data_ref().map_or(0, Bytes::len);
                if read > most_bytes {
                    break;
                }
            }
        };
        // Either way the body is dropped, and with it the connection.
        let _ = tokio::time::timeout(time, rest).await;
    });
}

/// An answer's body that keeps something until it has left, or its client.
///
/// It leaves in slices: a large piece would be taken over whole, and what it keeps be let go before the client has read it.
pub(super) struct Held<T> {
    body: Body,
    rest: Bytes,
    _held: T,
}

const SLICE: usize = 64 * 1024;

impl<T: Send + Unpin + 'static> Held<T> {
    pub(super) fn body(body: Body, held: T) -> Body {
        Body::new(Self { body, rest: Bytes::new(), _held: held })
    }
}

impl<T: Unpin> HttpBody for Held<T> {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.body).poll_frame(context)) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(data) => self.rest = data,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                other => return Poll::Ready(other),
            }
        }
        let length = self.rest.len().min(SLICE);
        Poll::Ready(Some(Ok(Frame::data(self.rest.split_to(length)))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (hint, rest) = (self.body.size_hint(), self.rest.len() as u64);
        let mut sum = SizeHint::new();
        sum.set_lower(hint.lower() + rest);
        if let Some(upper) = hint.upper() {
            sum.set_upper(upper + rest);
        }
        sum
    }
}
