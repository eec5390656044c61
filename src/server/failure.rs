use axum::http::StatusCode;
use tonic::Code;

use super::Cameras;
use crate::estimator::{CalibrateError, EstimateError, MeasureError, QueueError};
use crate::vision::DecodeError;
use posed_core::geometry::CameraError;

/// Why a request gets no estimate, in words that both protocols carry.
#[derive(Debug)]
pub(super) struct Failure {
    pub kind: FailureKind,
    pub message: String,
}

/// Each kind has one HTTP status and one gRPC code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FailureKind {
    InvalidRequest,
    InvalidImage,
    UnsupportedFormat,
    TooLarge,
    UnknownCamera,
    UnknownObject,
    NotCalibrated,
    Unmeasurable,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    QueueFull,
    TimedOut,
    Internal,
}

impl FailureKind {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::InvalidRequest => "invalid_request",
            Self::InvalidImage => "invalid_image",
            Self::UnsupportedFormat => "unsupported_format",
            Self::TooLarge => "too_large",
            Self::UnknownCamera => "unknown_camera",
            Self::UnknownObject => "unknown_object",
            Self::NotCalibrated => "not_calibrated",
            Self::Unmeasurable => "unmeasurable",
            Self::Forbidden => "forbidden",
            Self::NotFound => "not_found",
            Self::MethodNotAllowed => "method_not_allowed",
            Self::TimedOut => "timed_out",
            Self::QueueFull => "queue_full",
            Self::Internal => "internal",
        }
    }

    pub(super) fn http(self) -> StatusCode {
        match self {
            Self::InvalidRequest | Self::InvalidImage => StatusCode::BAD_REQUEST,
            Self::UnsupportedFormat => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            Self::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Self::UnknownCamera | Self::UnknownObject | Self::NotFound => StatusCode::NOT_FOUND,
            Self::NotCalibrated => StatusCode::CONFLICT,
            Self::Unmeasurable => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Forbidden => StatusCode::FORBIDDEN,
            Self::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
            Self::TimedOut => StatusCode::GATEWAY_TIMEOUT,
            Self::QueueFull => StatusCode::TOO_MANY_REQUESTS,
            Self::Internal => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }

    pub(super) fn grpc(self) -> Code {
        match self {
            Self::InvalidRequest | Self::InvalidImage | Self::UnsupportedFormat => Code::InvalidArgument,
            Self::TooLarge | Self::QueueFull => Code::ResourceExhausted,
            Self::UnknownCamera | Self::UnknownObject | Self::NotFound => Code::NotFound,
            Self::NotCalibrated | Self::Unmeasurable => Code::FailedPrecondition,
            Self::Forbidden => Code::PermissionDenied,
            Self::MethodNotAllowed => Code::Unimplemented,
            Self::TimedOut => Code::DeadlineExceeded,
            Self::Internal => Code::Internal,
        }
    }
}

impl Failure {
    pub(super) fn new(kind: FailureKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into() }
    }

    pub(super) fn unknown_camera(id: &str, cameras: &Cameras) -> Self {
        let known = cameras.ids().collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { "none".to_owned() } else { known };
        Self::new(
            FailureKind::UnknownCamera,
            format!("no camera {id:?}; known cameras: {known}. Start with --cameras DIR, or give the camera inline"),
        )
    }
}

impl From<CameraError> for Failure {
    fn from(error: CameraError) -> Self {
        Self::new(FailureKind::InvalidRequest, error.to_string())
    }
}

impl From<QueueError> for Failure {
    fn from(error: QueueError) -> Self {
        let kind = match &error {
            QueueError::Full { .. } | QueueError::FullBytes { .. } => FailureKind::QueueFull,
            QueueError::Abandoned(_) => FailureKind::TimedOut,
            QueueError::Decode(decode) => of_decode(decode),
            QueueError::Estimate(estimate) => of_estimate(estimate),
            QueueError::Measure(measure) => match measure {
                MeasureError::Estimate(estimate) => of_estimate(estimate),
                MeasureError::UnknownObject(_) => FailureKind::UnknownObject,
                MeasureError::Solve(_)
                | MeasureError::NotSeen
                | MeasureError::SeveralSeen
                | MeasureError::FewInliers { .. }
                | MeasureError::Doubtful { .. } => FailureKind::Unmeasurable,
            },
            QueueError::Crashed => FailureKind::Internal,
        };
        if kind == FailureKind::Internal {
            tracing::error!(%error, "an image could not be estimated");
        }
        Self::new(kind, error.to_string())
    }
}

fn of_decode(error: &DecodeError) -> FailureKind {
    match error {
        DecodeError::UnknownFormat => FailureKind::UnsupportedFormat,
        DecodeError::TooLarge { .. } => FailureKind::TooLarge,
        DecodeError::Empty
        | DecodeError::TooSmall { .. }
        | DecodeError::Truncated
        | DecodeError::Orientation(_)
        | DecodeError::Raw(_)
        | DecodeError::Damaged(_) => FailureKind::InvalidImage,
    }
}

fn of_estimate(error: &EstimateError) -> FailureKind {
    match error {
        EstimateError::Camera(_) => FailureKind::InvalidRequest,
        EstimateError::Abandoned(_) => FailureKind::TimedOut,
        EstimateError::Runtime(_) | EstimateError::Resample(_) => FailureKind::Internal,
    }
}

impl From<CalibrateError> for Failure {
    fn from(error: CalibrateError) -> Self {
        Self::new(FailureKind::Unmeasurable, error.to_string())
    }
}
