//! A line in the log and a place in the metrics for every request.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::Response;
use tracing::Instrument as _;

use crate::server::observe::span;
use crate::server::pending::Pending;
use crate::server::service::{FailureKind, Service};

pub(super) async fn observe(State(service): State<Arc<Service>>, request: Request, next: Next) -> Response {
    // Bounded: what is no route of ours is one label.
    let route = request.extensions().get::<MatchedPath>().map_or("unknown", MatchedPath::as_str).to_owned();
    let span = span("http", &request, &route);
    let for_poses = route.starts_with("/v1/poses");
    let pending = Pending::new(&service, "http", route, for_poses, span.clone());
    let response = next.run(request).instrument(span).await;
    let kind = response.extensions().get::<FailureKind>().copied().or_else(|| of_status(response.status()));
    pending.answered(kind.map_or("ok", FailureKind::name), Some(response.status().as_u16()));
    response
}

/// A failure that came about outside of our handlers.
fn of_status(status: StatusCode) -> Option<FailureKind> {
    if status.is_server_error() {
        Some(FailureKind::Internal)
    } else {
        status.is_client_error().then_some(FailureKind::InvalidRequest)
    }
}
