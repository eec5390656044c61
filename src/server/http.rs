//! The HTTP front end.

use std::sync::atomic::Ordering;

use axum::body::Bytes;
use axum::extract::rejection::{BytesRejection, QueryRejection};
use axum::extract::{DefaultBodyLimit, Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::{Deserialize, Serialize};

use super::App;
use super::failure::{Failure, FailureKind};
use crate::estimator::{Report, Work};
use crate::geometry::Camera;

pub(super) fn router(app: App) -> Router {
    Router::new()
        .route("/v1/poses", post(poses))
        .route("/livez", get(|| async { "live\n" }))
        .route("/readyz", get(ready))
        .fallback(|| async { Failure::new(FailureKind::NotFound, "no such path; see POST /v1/poses") })
        .layer(DefaultBodyLimit::max(app.max_body_bytes))
        .with_state(app)
}

/// `?camera=ID`, or `?fx=&fy=&cx=&cy=`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraQuery {
    camera: Option<String>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
}

async fn poses(
    State(app): State<App>,
    query: Result<Query<CameraQuery>, QueryRejection>,
    body: Result<Bytes, BytesRejection>,
) -> Result<Json<Report>, Failure> {
    let camera = query.map_err(|rejection| bad_query(&rejection))?.0.camera(&app)?;
    let image = body.map_err(|rejection| bad_body(&rejection, app.max_body_bytes))?;
    let answer = app.queue.estimate(Work { image: image.into(), camera }).await?;
    Ok(Json(answer.into()))
}

async fn ready(State(app): State<App>) -> (StatusCode, &'static str) {
    if app.ready.load(Ordering::Relaxed) {
        (StatusCode::OK, "ready\n")
    } else {
        (StatusCode::SERVICE_UNAVAILABLE, "shutting down\n")
    }
}

impl CameraQuery {
    fn camera(self, app: &App) -> Result<Camera, Failure> {
        match (self.camera, [self.fx, self.fy, self.cx, self.cy]) {
            (Some(id), [None, None, None, None]) => {
                app.cameras.get(&id).cloned().ok_or_else(|| Failure::unknown_camera(&id, &app.cameras))
            }
            (None, [Some(fx), Some(fy), Some(cx), Some(cy)]) => Ok(Camera::pinhole(fx, fy, cx, cy)?),
            (Some(_), _) => Err(invalid("give either 'camera' or 'fx', 'fy', 'cx', 'cy', not both")),
            (None, _) => Err(invalid("no camera: give 'camera' (an id) or all of 'fx', 'fy', 'cx', 'cy' (pixels)")),
        }
    }
}

fn invalid(message: &str) -> Failure {
    Failure::new(FailureKind::InvalidRequest, message)
}

fn bad_query(rejection: &QueryRejection) -> Failure {
    Failure::new(FailureKind::InvalidRequest, rejection.body_text())
}

fn bad_body(rejection: &BytesRejection, limit: usize) -> Failure {
    if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
        Failure::new(FailureKind::TooLarge, format!("the body is larger than {limit} bytes (--max-body-bytes)"))
    } else {
        Failure::new(FailureKind::InvalidRequest, rejection.body_text())
    }
}

#[derive(Serialize)]
struct ErrorBody {
    error: ErrorDetail,
}

#[derive(Serialize)]
struct ErrorDetail {
    code: &'static str,
    message: String,
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let body = ErrorBody { error: ErrorDetail { code: self.kind.name(), message: self.message } };
        let mut response = (self.kind.http(), Json(body)).into_response();
        if self.kind == FailureKind::QueueFull {
            response.headers_mut().insert(header::RETRY_AFTER, header::HeaderValue::from_static("1"));
        }
        response
    }
}
