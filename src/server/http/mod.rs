//! The HTTP front end.

mod batch;
mod body;
mod info;
mod observe;
mod poses;
mod reference;

use axum::extract::DefaultBodyLimit;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use axum::{Json, Router, middleware};
use serde::Serialize;
use utoipa::{OpenApi, ToSchema};

use super::App;
use super::failure::{Failure, FailureKind};

pub(super) fn router(app: App) -> Router {
    let not_allowed =
        || async { Failure::new(FailureKind::MethodNotAllowed, "this path has other methods; see /openapi.json") };
    Router::new()
        .route("/v1/poses", post(poses::poses))
        .route("/v1/poses/batch", post(batch::batch))
        .route("/v1/objects", get(info::objects))
        .route("/v1/objects/{name}", get(info::object))
        .route("/v1/objects/{name}/reference", put(reference::replace))
        .route("/v1/cameras", get(info::cameras))
        .route("/v1/limits", get(info::limits))
        .route("/openapi.json", get(|| async { ([(header::CONTENT_TYPE, "application/json")], openapi()) }))
        .fallback(|| async { Failure::new(FailureKind::NotFound, "no such path; see /openapi.json") })
        .method_not_allowed_fallback(not_allowed)
        .layer(DefaultBodyLimit::max(app.config.max_body_bytes))
        .layer(middleware::from_fn_with_state(app.clone(), observe::observe))
        .with_state(app)
}

/// The description of this interface: `docs/openapi.json`, served at `/openapi.json`.
#[must_use]
pub fn openapi() -> String {
    let mut text = Documentation::openapi().to_pretty_json().unwrap_or_default();
    text.push('\n');
    text
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "posed",
        description = "6D poses of known rigid objects from one RGB image. Lengths are metres, angles radians, image quantities \
                       pixels with pixel centres at integers. The camera frame is OpenCV's: x right, y down, z forward.",
    ),
    paths(poses::poses, batch::batch, info::objects, info::object, reference::replace, info::cameras, info::limits,),
    components(schemas(super::request::EstimateRequest, super::request::CameraChoice, reference::ReferenceRequest))
)]
struct Documentation;

/// Every answer that is no success.
#[derive(Serialize, ToSchema)]
struct ErrorBody {
    error: ErrorDetail,
}

#[derive(Serialize, ToSchema)]
struct ErrorDetail {
    /// For programs.
    #[schema(example = "unknown_camera")]
    code: &'static str,
    /// For people: what is wrong, which limit or field, and what to do.
    message: String,
}

impl From<&Failure> for ErrorBody {
    fn from(failure: &Failure) -> Self {
        Self { error: ErrorDetail { code: failure.kind.name(), message: failure.message.clone() } }
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let mut response = (self.kind.http(), Json(ErrorBody::from(&self))).into_response();
        if self.kind == FailureKind::QueueFull {
            response.headers_mut().insert(header::RETRY_AFTER, header::HeaderValue::from_static("1"));
        }
        response.extensions_mut().insert(self.kind);
        response
    }
}
