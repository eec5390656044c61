//! What every request gets: an id, a line in the log, a place in the metrics.

use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::HeaderValue;
use axum::middleware::Next;
use axum::response::Response;
use tracing::Instrument as _;

use crate::server::App;
use crate::server::failure::FailureKind;
use crate::server::marks::{Marks, REQUEST_ID, TRACE_PARENT};

pub(super) async fn observe(State(app): State<App>, request: Request, next: Next) -> Response {
    let start = Instant::now();
    let Marks { id, trace_parent } = Marks::of(request.headers());
    // Bounded: what is no route of ours is one label.
    let route = request.extensions().get::<MatchedPath>().map_or("unknown", MatchedPath::as_str).to_owned();
    let span = tracing::info_span!("http", id, traceparent = trace_parent, method = %request.method(), route);
    let mut response = next.run(request).instrument(span.clone()).await;
    let duration = start.elapsed();
    let outcome = response.extensions().get::<FailureKind>().map_or("ok", |kind| kind.name());
    app.metrics.request("http", &route, outcome, duration);
    tracing::info!(parent: &span, status = response.status().as_u16(), outcome, ms = duration.as_millis());
    for (name, mark) in [(REQUEST_ID, Some(id)), (TRACE_PARENT, trace_parent)] {
        if let Some(Ok(value)) = mark.map(HeaderValue::try_from) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}
