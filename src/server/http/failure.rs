//! Failures as HTTP answers.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use crate::server::api::json::ErrorBody;
use crate::server::service::{Failure, FailureKind};

pub(super) fn status(kind: FailureKind) -> StatusCode {
    match kind {
        FailureKind::InvalidRequest | FailureKind::InvalidImage | FailureKind::Cancelled => StatusCode::BAD_REQUEST,
        FailureKind::UnsupportedFormat => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        FailureKind::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
        FailureKind::UnknownCamera | FailureKind::UnknownObject | FailureKind::NotFound => StatusCode::NOT_FOUND,
        FailureKind::NotCalibrated => StatusCode::CONFLICT,
        FailureKind::Unmeasurable | FailureKind::InvalidBundle => StatusCode::UNPROCESSABLE_ENTITY,
        FailureKind::Unauthenticated => StatusCode::UNAUTHORIZED,
        FailureKind::Forbidden => StatusCode::FORBIDDEN,
        FailureKind::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
        FailureKind::TimedOut => StatusCode::GATEWAY_TIMEOUT,
        FailureKind::QueueFull => StatusCode::TOO_MANY_REQUESTS,
        FailureKind::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
        FailureKind::Internal => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

/// The answer to a method that a path does not have.
pub(super) async fn not_allowed() -> Failure {
    Failure::new(FailureKind::MethodNotAllowed, "this path does not support the method; see /openapi.json")
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let mut response = (status(self.kind), Json(ErrorBody::from(&self))).into_response();
        if self.kind == FailureKind::QueueFull {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
        }
        if self.kind == FailureKind::Unauthenticated {
            response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        // For the log and the metrics.
        response.extensions_mut().insert(self.kind);
        response
    }
}
