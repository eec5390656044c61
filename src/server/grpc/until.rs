//! Answers that end with the server: those that nobody's work waits for.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::Frame;
use tonic::Status;

type Stop = Pin<Box<dyn Future<Output = ()> + Send>>;

/// A body that a stop ends, with a word about why.
pub(super) struct Until {
    body: Body,
    stop: Stop,
    ended: bool,
}

impl Until {
    pub(super) fn body(body: Body, stop: impl Future<Output = ()> + Send + 'static) -> Body {
        Body::new(Self { body, stop: Box::pin(stop), ended: false })
    }
}

pub(super) fn shutting_down() -> Status {
    Status::unavailable("the server is shutting down; connect again")
}

impl HttpBody for Until {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.ended {
            return Poll::Ready(None);
        }
        let frame = Pin::new(&mut self.body).poll_frame(context);
        if frame.is_ready() || self.stop.as_mut().poll(context).is_pending() {
            return frame;
        }
        self.ended = true;
        let trailers = shutting_down().into_http::<Body>().headers().clone();
        Poll::Ready(Some(Ok(Frame::trailers(trailers))))
    }

    fn is_end_stream(&self) -> bool {
        self.ended || self.body.is_end_stream()
    }
}
