//! For operators, on a port of its own: probes, metrics, the log level.

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, put};

use super::service::Readiness;
use super::telemetry::LogControl;

#[derive(Clone)]
struct Admin {
    readiness: Readiness,
    logs: LogControl,
}

pub(super) fn router(readiness: Readiness, logs: LogControl) -> Router {
    Router::new()
        .route("/livez", get(|| async { "live\n" }))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics))
        .route("/log-level", put(log_level))
        .with_state(Admin { readiness, logs })
}

async fn ready(State(admin): State<Admin>) -> (StatusCode, String) {
    match admin.readiness.check() {
        Ok(()) => (StatusCode::OK, "ready\n".into()),
        Err(reason) => (StatusCode::SERVICE_UNAVAILABLE, format!("{reason}\n")),
    }
}

async fn metrics(State(admin): State<Admin>) -> Response {
    const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    match admin.readiness.service() {
        Some(service) => ([(header::CONTENT_TYPE, OPEN_METRICS)], service.metrics.encode()).into_response(),
        None => (StatusCode::SERVICE_UNAVAILABLE, "loading the models\n").into_response(),
    }
}

/// The body is a filter: `debug`, or `info,posed=debug`.
async fn log_level(State(admin): State<Admin>, filter: String) -> (StatusCode, String) {
    match admin.logs.set(filter.trim()) {
        Ok(()) => {
            tracing::info!("log filter is now {:?}", filter.trim());
            (StatusCode::OK, "done\n".into())
        }
        Err(reason) => (StatusCode::BAD_REQUEST, format!("{reason}\n")),
    }
}
