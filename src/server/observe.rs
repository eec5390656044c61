//! What every request gets, on every front end: an id, a line in the log, a place in the metrics, and an answer even
//! where its handler panics.

use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue};
use axum::middleware::Next;
use axum::response::Response;
use axum::{Router, middleware};
use tower::ServiceBuilder;
use tower_http::propagate_header::PropagateHeaderLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tracing::Span;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TRACE_PARENT: HeaderName = HeaderName::from_static("traceparent");
const MAX_BYTES: usize = 128;

/// Keeps the caller's marks, or gives a request its own id: in the log and in the answer.
pub(super) fn with_marks(router: Router) -> Router {
    let marks = ServiceBuilder::new()
        .layer(middleware::from_fn(forget_bad_marks))
        .layer(SetRequestIdLayer::new(REQUEST_ID, MakeRequestUuid))
        .layer(PropagateRequestIdLayer::new(REQUEST_ID))
        .layer(PropagateHeaderLayer::new(TRACE_PARENT));
    router.layer(marks)
}

/// A request's span, with its marks.
pub(super) fn span(protocol: &'static str, request: &Request, route: &str) -> Span {
    let mark = |name: HeaderName| request.headers().get(name).and_then(|value| value.to_str().ok());
    let (id, traceparent) = (mark(REQUEST_ID), mark(TRACE_PARENT));
    tracing::info_span!("request", protocol, id, traceparent, method = %request.method(), route)
}

/// Visible ASCII of bounded length; anything else is ignored.
async fn forget_bad_marks(mut request: Request, next: Next) -> Response {
    let good = |value: &HeaderValue| (1..=MAX_BYTES).contains(&value.len()) && value.to_str().is_ok();
    for name in [REQUEST_ID, TRACE_PARENT] {
        if request.headers().get(&name).is_some_and(|value| !good(value)) {
            request.headers_mut().remove(&name);
        }
    }
    next.run(request).await
}
