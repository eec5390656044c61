//! A line in the log and a place in the metrics for every request.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::middleware::Next;
use axum::response::Response;
use tracing::Instrument as _;

use crate::server::observe::span;
use crate::server::service::{Answered, FailureKind, Service};

pub(super) async fn observe(State(service): State<Arc<Service>>, request: Request, next: Next) -> Response {
    let start = Instant::now();
    // Bounded: what is no route of ours is one label.
    let route = request.extensions().get::<MatchedPath>().map_or("unknown", MatchedPath::as_str).to_owned();
    let span = span("http", &request, &route);
    let response = next.run(request).instrument(span.clone()).await;
    let duration = start.elapsed();
    let outcome = response.extensions().get::<FailureKind>().map_or("ok", |kind| kind.name());
    let for_poses = route.starts_with("/v1/poses");
    service.answered(&Answered { protocol: "http", route: &route, for_poses, outcome, duration });
    tracing::info!(parent: &span, status = response.status().as_u16(), outcome, ms = duration.as_millis());
    response
}
