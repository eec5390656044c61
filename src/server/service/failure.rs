//! What can go wrong with a request.

use super::cameras::Cameras;
use crate::estimator::{CalibrateError, EstimateError, MeasureError, QueueError, Refusal};
use crate::model::Library;
use crate::vision::DecodeError;
use posed_core::calibration::ClickError;
use posed_core::geometry::CameraError;

/// More than any sentence of ours has.
const MAX_MESSAGE_CHARS: usize = 600;

/// Why a request failed, with a message that every protocol carries.
#[derive(Debug)]
pub(crate) struct Failure {
    pub kind: FailureKind,
    pub message: String,
}

/// Each front end has one status for each kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FailureKind {
    InvalidRequest,
    InvalidImage,
    UnsupportedFormat,
    TooLarge,
    UnknownCamera,
    UnknownObject,
    NotCalibrated,
    Unmeasurable,
    InvalidBundle,
    Unauthenticated,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    QueueFull,
    Unavailable,
    TimedOut,
    /// The caller left before all of its request was here.
    Cancelled,
    Internal,
}

impl FailureKind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::InvalidRequest => "invalid_request",
            Self::InvalidImage => "invalid_image",
            Self::UnsupportedFormat => "unsupported_format",
            Self::TooLarge => "too_large",
            Self::UnknownCamera => "unknown_camera",
            Self::UnknownObject => "unknown_object",
            Self::NotCalibrated => "not_calibrated",
            Self::Unmeasurable => "unmeasurable",
            Self::InvalidBundle => "invalid_bundle",
            Self::Unauthenticated => "unauthenticated",
            Self::Forbidden => "forbidden",
            Self::NotFound => "not_found",
            Self::MethodNotAllowed => "method_not_allowed",
            Self::TimedOut => "timed_out",
            Self::QueueFull => "queue_full",
            Self::Unavailable => "unavailable",
            Self::Cancelled => "cancelled",
            Self::Internal => "internal",
        }
    }
}

impl Failure {
    /// Long messages repeat what the client sent; they are cut, so that an answer is never larger than its request.
    pub(crate) fn new(kind: FailureKind, message: impl Into<String>) -> Self {
        let mut message: String = message.into();
        if let Some((end, _)) = message.char_indices().nth(MAX_MESSAGE_CHARS) {
            message = format!("{}…", &message[..end]);
        }
        Self { kind, message }
    }

    pub(crate) fn invalid(message: impl Into<String>) -> Self {
        Self::new(FailureKind::InvalidRequest, message)
    }

    /// Of a body that is held to the setting of this name.
    pub(crate) fn too_large(limit: usize, setting: &str) -> Self {
        Self::new(FailureKind::TooLarge, format!("the body exceeds the limit of {limit} bytes ('{setting}')"))
    }

    pub(crate) fn body_too_large(limit: usize) -> Self {
        Self::too_large(limit, "max_body_bytes")
    }

    pub(crate) fn unknown_camera(id: &str, cameras: &Cameras) -> Self {
        let known = cameras.ids().collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { "none".to_owned() } else { known };
        Self::new(
            FailureKind::UnknownCamera,
            format!(
                "unknown camera {id:?}; known cameras: {known}. Register it with --cameras, or send its parameters"
            ),
        )
    }
}

impl Failure {
    pub(super) fn unknown_object(name: &str, library: &Library) -> Self {
        let known: Vec<&str> = library.known().map(|object| object.manifest.name.as_str()).collect();
        let message = format!("unknown object {name:?}; known objects: {}", known.join(", "));
        Self::new(FailureKind::UnknownObject, message)
    }

    pub(crate) fn unknown_rig(id: &str, cameras: &Cameras) -> Self {
        let known = cameras.rigs().map(|(id, _)| id).collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { "none".to_owned() } else { known };
        let message = format!(
            "unknown rig {id:?}; known rigs: {known}. Put {id}.rig.json into the folder --cameras, or send 'views'"
        );
        Self::new(FailureKind::UnknownCamera, message)
    }
}

impl From<CameraError> for Failure {
    fn from(error: CameraError) -> Self {
        Self::new(FailureKind::InvalidRequest, error.to_string())
    }
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Self {
        Self::new(of_refusal(refusal), refusal.to_string())
    }
}

impl From<QueueError> for Failure {
    fn from(error: QueueError) -> Self {
        let kind = match &error {
            QueueError::Refused(refusal) => of_refusal(*refusal),
            QueueError::Abandoned(_) => FailureKind::TimedOut,
            QueueError::Decode(decode) => of_decode(decode),
            QueueError::TooCostly { .. } => FailureKind::TooLarge,
            QueueError::Estimate(estimate) => of_estimate(estimate),
            QueueError::Measure(measure) => match measure {
                MeasureError::Estimate(estimate) => of_estimate(estimate),
                MeasureError::UnknownObject(_) => FailureKind::UnknownObject,
                MeasureError::Solve(_)
                | MeasureError::Unfit { .. }
                | MeasureError::BoxOutside(_)
                | MeasureError::NotSeen
                | MeasureError::NoLabel
                | MeasureError::SeveralSeen
                | MeasureError::FewInliers { .. }
                | MeasureError::Doubtful { .. } => FailureKind::Unmeasurable,
            },
            QueueError::Crashed => FailureKind::Internal,
        };
        if kind == FailureKind::Internal {
            tracing::error!(%error, "an image could not be estimated");
        }
        let setting = if matches!(error, QueueError::Decode(DecodeError::Orientation(_))) {
            ". The server can turn them, or ignore it: change its setting 'exif_orientation' to 'apply' or 'ignore'"
        } else {
            ""
        };
        Self::new(kind, format!("{error}{setting}"))
    }
}

fn of_refusal(refusal: Refusal) -> FailureKind {
    match refusal {
        Refusal::Images { .. } | Refusal::Bytes { .. } | Refusal::Busy { .. } => FailureKind::QueueFull,
        Refusal::Hasty { .. } => FailureKind::TimedOut,
        Refusal::NoWorkers => FailureKind::Unavailable,
    }
}

fn of_decode(error: &DecodeError) -> FailureKind {
    match error {
        DecodeError::UnknownFormat => FailureKind::UnsupportedFormat,
        DecodeError::TooLarge { .. } => FailureKind::TooLarge,
        DecodeError::Empty
        | DecodeError::TooSmall { .. }
        | DecodeError::Animated
        | DecodeError::Truncated
        | DecodeError::Orientation(_)
        | DecodeError::Raw(_)
        | DecodeError::Damaged(_) => FailureKind::InvalidImage,
    }
}

fn of_estimate(error: &EstimateError) -> FailureKind {
    match error {
        EstimateError::Camera(_) | EstimateError::OtherSize(_) | EstimateError::BoxOutside { .. } => {
            FailureKind::InvalidRequest
        }
        EstimateError::Abandoned(_) => FailureKind::TimedOut,
        EstimateError::Runtime(_) | EstimateError::Resample(_) => FailureKind::Internal,
    }
}

impl From<CalibrateError> for Failure {
    fn from(error: CalibrateError) -> Self {
        Self::new(FailureKind::Unmeasurable, error.to_string())
    }
}

impl From<ClickError> for Failure {
    fn from(error: ClickError) -> Self {
        let kind = match error {
            ClickError::Count(_) | ClickError::Sigma(_) | ClickError::FrameIndex { .. } => FailureKind::InvalidRequest,
            ClickError::Triangulation { .. }
            | ClickError::RaysMiss { .. }
            | ClickError::Outlier { .. }
            | ClickError::SameImage
            | ClickError::DegenerateFrame
            | ClickError::Pnp(_)
            | ClickError::Contradiction { .. } => FailureKind::Unmeasurable,
        };
        Self::new(kind, format!("field 'clicks': {error}"))
    }
}
