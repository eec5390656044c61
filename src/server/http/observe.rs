//! What every request gets: an id, a line in the log, a place in the metrics.

use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::middleware::Next;
use axum::response::Response;
use tracing::Instrument as _;
use uuid::Uuid;

use crate::server::App;
use crate::server::failure::FailureKind;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TRACE_PARENT: HeaderName = HeaderName::from_static("traceparent");
const MAX_ID_BYTES: usize = 128;

pub(super) async fn observe(State(app): State<App>, request: Request, next: Next) -> Response {
    let start = Instant::now();
    let id = request_id(request.headers());
    // W3C trace context: kept for whoever reads the logs, and given back.
    let trace_parent = given(request.headers(), &TRACE_PARENT).cloned();
    // Bounded: what is no route of ours is one label.
    let route = request.extensions().get::<MatchedPath>().map_or("unknown", MatchedPath::as_str).to_owned();
    let span = tracing::info_span!(
        "http",
        id = id.to_str().unwrap_or_default(),
        traceparent = trace_parent.as_ref().and_then(|value| value.to_str().ok()),
        method = %request.method(),
        route,
    );
    let mut response = next.run(request).instrument(span.clone()).await;
    let duration = start.elapsed();
    let outcome = response.extensions().get::<FailureKind>().map_or("ok", |kind| kind.name());
    app.metrics.request("http", &route, outcome, duration);
    tracing::info!(parent: &span, status = response.status().as_u16(), outcome, ms = duration.as_millis());
    response.headers_mut().insert(REQUEST_ID, id);
    if let Some(value) = trace_parent {
        response.headers_mut().insert(TRACE_PARENT, value);
    }
    response
}

/// The caller's id, or a new one.
fn request_id(headers: &HeaderMap) -> HeaderValue {
    let given = given(headers, &REQUEST_ID).filter(|value| !value.is_empty()).cloned();
    // A UUID is visible ASCII.
    given
        .or_else(|| HeaderValue::from_str(&Uuid::new_v4().to_string()).ok())
        .unwrap_or(HeaderValue::from_static("none"))
}

/// A header that can be logged and given back: visible ASCII of bounded length.
fn given<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a HeaderValue> {
    headers.get(name).filter(|value| value.len() <= MAX_ID_BYTES && value.to_str().is_ok())
}
