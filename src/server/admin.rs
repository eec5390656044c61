//! For operators, on a port of its own: probes, metrics, the log level.

use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, put};
use axum::{Router, middleware};

use super::service::{Access, Failure, FailureKind, Readiness, Scope, Service};
use super::telemetry::LogControl;

#[derive(Clone)]
struct Admin {
    readiness: Readiness,
    logs: LogControl,
    access: Access,
}

pub(super) fn router(readiness: Readiness, logs: LogControl, access: Access) -> Router {
    let admin = Admin { readiness, logs, access };
    Router::new()
        .route("/metrics", get(metrics))
        .route("/log-level", put(log_level))
        .layer(middleware::from_fn_with_state(admin.clone(), allow))
        .route("/livez", get(|| async { "live\n" }))
        .route("/readyz", get(ready))
        .with_state(admin)
}

/// Probes have no tokens; the rest is for whoever has one.
async fn allow(State(admin): State<Admin>, request: Request, next: Next) -> Response {
    let authorization = request.headers().get(header::AUTHORIZATION).map(HeaderValue::as_bytes);
    match admin.access.check(authorization, Scope::Admin) {
        Ok(()) => next.run(request).await,
        Err(Failure { kind: FailureKind::Forbidden, message }) => {
            (StatusCode::FORBIDDEN, format!("{message}\n")).into_response()
        }
        Err(failure) => {
            let asked = [(header::WWW_AUTHENTICATE, "Bearer")];
            (StatusCode::UNAUTHORIZED, asked, format!("{}\n", failure.message)).into_response()
        }
    }
}

async fn ready(State(admin): State<Admin>) -> (StatusCode, String) {
    match admin.readiness.check() {
        Ok(()) => {
            let notes = admin.readiness.service().map(Service::notes).unwrap_or_default();
            let lines = std::iter::once("ready".to_owned()).chain(notes);
            (StatusCode::OK, lines.map(|line| line + "\n").collect())
        }
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
