//! For operators, on a port of its own: probes, metrics, the log level.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, put};

use super::App;
use super::telemetry::LogControl;

/// Known before anything is loaded, so that probes are answered from the first moment.
#[derive(Clone)]
pub(super) struct Admin {
    app: Arc<OnceLock<App>>,
    draining: Arc<AtomicBool>,
    logs: LogControl,
}

impl Admin {
    pub(super) fn new(logs: LogControl) -> Self {
        Self { app: Arc::default(), draining: Arc::default(), logs }
    }

    /// Everything is loaded and warmed up.
    pub(super) fn set_ready(&self, app: App) {
        // Said once, by the only one who loads.
        let _ = self.app.set(app);
    }

    pub(super) fn set_draining(&self) {
        self.draining.store(true, Ordering::Relaxed);
    }

    /// `Err` says why no request should come here now.
    pub(super) fn readiness(&self) -> Result<(), &'static str> {
        let Some(app) = self.app.get() else { return Err("loading the models") };
        if self.draining.load(Ordering::Relaxed) {
            return Err("shutting down");
        }
        if app.queue.stats().ready_workers.load(Ordering::Relaxed) == 0 {
            return Err("no worker is left; see the log");
        }
        let servable = app.library.known().any(|object| app.is_calibrated(&object.manifest.name));
        if !servable && !app.config.recalibration {
            return Err("no object is calibrated; see `posed calibrate --help`");
        }
        Ok(())
    }
}

pub(super) fn router(admin: Admin) -> Router {
    Router::new()
        .route("/livez", get(|| async { "live\n" }))
        .route("/readyz", get(ready))
        .route("/metrics", get(metrics))
        .route("/log-level", put(log_level))
        .with_state(admin)
}

async fn ready(State(admin): State<Admin>) -> (StatusCode, String) {
    match admin.readiness() {
        Ok(()) => (StatusCode::OK, "ready\n".into()),
        Err(reason) => (StatusCode::SERVICE_UNAVAILABLE, format!("{reason}\n")),
    }
}

async fn metrics(State(admin): State<Admin>) -> Response {
    const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    match admin.app.get() {
        Some(app) => ([(header::CONTENT_TYPE, OPEN_METRICS)], app.metrics.encode()).into_response(),
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
