//! Bodies under a lease: room is asked for before they are read, and counted as they come.

use std::error::Error;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use thiserror::Error;

use super::timeout;
use crate::estimator::{BodyLease, Refusal};
use crate::server::body::{Held, Stall, drain};
use crate::server::service::{Failure, FailureKind, Scope, Service};

/// What a request was admitted with, for its handler.
#[derive(Clone)]
pub(super) struct Admitted {
    /// The room of its body.
    pub body: Arc<BodyLease>,
    /// When its time is over.
    pub deadline: Instant,
}

/// Where objects come and go.
const OBJECT: &str = "/v1/objects/{name}";

/// Why a body is not read to its end.
#[derive(Debug, Error)]
pub(super) enum UploadError {
    #[error("larger than {limit} bytes")]
    TooLarge { limit: usize, setting: &'static str },
    #[error(transparent)]
    Refused(#[from] Refusal),
    #[error("stalled")]
    Stalled,
    #[error("ended early")]
    Broken(#[source] axum::Error),
}

/// Asks who it is, and for room, before the body is read. What is refused is refused here, before the upload.
pub(super) async fn admit(State(service): State<Arc<Service>>, request: Request, next: Next) -> Response {
    let of_object = request.extensions().get::<MatchedPath>().is_some_and(|path| path.as_str() == OBJECT);
    let scope = match *request.method() {
        Method::GET | Method::HEAD => Scope::Any,
        Method::PUT | Method::DELETE if of_object => Scope::Objects,
        Method::PUT => Scope::Calibrate,
        _ => Scope::Estimate,
    };
    let allowed = service.access.check(request.headers().get(header::AUTHORIZATION).map(HeaderValue::as_bytes), scope);
    if scope == Scope::Any {
        return match allowed {
            Ok(()) => next.run(request).await,
            Err(failure) => failure.into_response(),
        };
    }
    let (mut parts, body) = request.into_parts();
    let unread = Unread::new(&parts.headers);
    let timeout = service.limits.body_timeout;
    let is_bundle = scope == Scope::Objects;
    let (limit, setting) = if is_bundle {
        (service.limits.max_bundle_bytes, "max_bundle_bytes")
    } else {
        (service.limits.max_body_bytes, "max_body_bytes")
    };
    let upload = |lease| {
        let unread = unread.clone();
        Upload { body, lease, received: 0, limit, setting, timeout, stall: None, waits: false, unread }
    };
    let admitted = allowed
        .and_then(|()| if is_bundle { bundle(&service, &parts.headers) } else { body_of(&service, &parts.headers) });
    let mut response = match admitted {
        Ok(admitted) => {
            let lease = Arc::clone(&admitted.body);
            parts.extensions.insert(admitted);
            // A bundle goes to the disk as it comes.
            let body = Body::new(upload((!is_bundle).then(|| Arc::clone(&lease))));
            let response = next.run(Request::from_parts(parts, body)).await;
            // Until the answer has left: a client that does not read it has no room for more.
            response.map(|body| Held::body(body, lease))
        }
        Err(failure) => {
            drop(upload(None));
            failure.into_response()
        }
    };
    if unread.is_unread() {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}

/// A body that is held in memory.
fn body_of(service: &Service, headers: &HeaderMap) -> Result<Admitted, Failure> {
    let deadline = timeout::deadline(service, headers)?;
    Ok(Admitted { body: service.admit(announced(headers), deadline)?, deadline })
}

/// A bundle, which takes no room of others.
fn bundle(service: &Service, headers: &HeaderMap) -> Result<Admitted, Failure> {
    service.may_change_objects()?;
    let limit = service.limits.max_bundle_bytes;
    if announced(headers).is_some_and(|bytes| bytes > limit as u64) {
        return Err(Failure::too_large(limit, "max_bundle_bytes"));
    }
    Ok(Admitted { body: service.lease(), deadline: timeout::long_deadline(service, headers)? })
}

/// The length that a body states.
fn announced(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// Whether something of a body is still to come.
#[derive(Clone)]
struct Unread {
    finished: Arc<AtomicBool>,
    /// The client waits for our word before it sends ('Expect: 100-continue'): where it was not given nothing comes.
    waits: Arc<AtomicBool>,
}

impl Unread {
    fn new(headers: &HeaderMap) -> Self {
        let waits = headers.contains_key(header::EXPECT);
        Self { finished: Arc::default(), waits: Arc::new(AtomicBool::new(waits)) }
    }

    fn finish(&self) {
        self.finished.store(true, Ordering::Relaxed);
    }

    fn is_unread(&self) -> bool {
        !self.finished.load(Ordering::Relaxed)
    }
}

/// A request's body.
struct Upload {
    body: Body,
    /// None where there is no room, and it is only read to a bounded end; and where it takes none.
    lease: Option<Arc<BodyLease>>,
    received: usize,
    limit: usize,
    /// That states it.
    setting: &'static str,
    timeout: Duration,
    stall: Option<Stall>,
    /// Whether nothing has come since it was asked for.
    waits: bool,
    unread: Unread,
}

impl Upload {
    fn count(&mut self, frame: &Frame<Bytes>) -> Result<(), UploadError> {
        self.received += frame.data_ref().map_or(0, Bytes::len);
        if self.received > self.limit {
            return Err(UploadError::TooLarge { limit: self.limit, setting: self.setting });
        }
        let lease = self.lease.as_ref().map(|lease| lease.grow_to(self.received));
        Ok(lease.transpose().map(drop)?)
    }
}

impl HttpBody for Upload {
    type Data = Bytes;
    type Error = UploadError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, UploadError>>> {
        self.unread.waits.store(false, Ordering::Relaxed);
        match Pin::new(&mut self.body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                self.waits = false;
                Poll::Ready(Some(self.count(&frame).map(|()| frame)))
            }
            Poll::Ready(Some(Err(error))) => Poll::Ready(Some(Err(UploadError::Broken(error)))),
            Poll::Ready(None) => {
                self.unread.finish();
                Poll::Ready(None)
            }
            Poll::Pending => {
                let (timeout, began) = (self.timeout, !std::mem::replace(&mut self.waits, true));
                let stall = self.stall.get_or_insert_with(|| Stall::new(timeout));
                // The client's time, not that of whoever takes what it sends.
                if began {
                    stall.reset();
                }
                stall.poll(context).map(|()| Some(Err(UploadError::Stalled)))
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        if self.body.is_end_stream() {
            self.unread.finish();
        }
        if self.unread.is_unread() && !self.unread.waits.load(Ordering::Relaxed) {
            drain(std::mem::take(&mut self.body), self.limit, self.timeout);
        }
    }
}

impl From<&UploadError> for Failure {
    fn from(error: &UploadError) -> Self {
        match error {
            UploadError::TooLarge { limit, setting } => Self::too_large(*limit, setting),
            UploadError::Refused(refusal) => (*refusal).into(),
            UploadError::Stalled => Self::new(
                FailureKind::TimedOut,
                "the request body stalled for longer than 'body_timeout_ms'; send it without pauses",
            ),
            UploadError::Broken(error) => {
                let kind = if has_left(error) { FailureKind::Cancelled } else { FailureKind::InvalidRequest };
                Self::new(kind, "the request body ended early or is malformed; check its length and its chunks")
            }
        }
    }
}

/// Whether it is the connection that ended, and not the body that is malformed.
fn has_left(error: &axum::Error) -> bool {
    let kinds = [ErrorKind::UnexpectedEof, ErrorKind::ConnectionReset, ErrorKind::ConnectionAborted];
    source_of::<io::Error>(error).is_some_and(|error| kinds.contains(&error.kind()))
}

/// The first error of this type among an error and its sources.
pub(super) fn source_of<'a, T: Error + 'static>(error: &'a (dyn Error + 'static)) -> Option<&'a T> {
    std::iter::successors(Some(error), |&error| error.source()).find_map(|error| error.downcast_ref())
}
