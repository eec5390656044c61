//! Failures as gRPC statuses.

use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt as _};

use crate::server::service::{Failure, FailureKind};

/// When to try again where there was no room.
const RETRY_DELAY: Duration = Duration::from_secs(1);

/// In the message of a status: the caller left within its request.
const UNENDED: [&str; 3] = ["Unexpected EOF", "h2 protocol error", "error reading a body"];

pub(super) fn code(kind: FailureKind) -> Code {
    match kind {
        FailureKind::InvalidRequest
        | FailureKind::InvalidImage
        | FailureKind::UnsupportedFormat
        | FailureKind::InvalidBundle => Code::InvalidArgument,
        FailureKind::TooLarge | FailureKind::QueueFull => Code::ResourceExhausted,
        FailureKind::UnknownCamera | FailureKind::UnknownObject | FailureKind::NotFound => Code::NotFound,
        FailureKind::NotCalibrated | FailureKind::Unmeasurable => Code::FailedPrecondition,
        FailureKind::Unauthenticated => Code::Unauthenticated,
        FailureKind::Forbidden => Code::PermissionDenied,
        FailureKind::MethodNotAllowed => Code::Unimplemented,
        FailureKind::Unavailable => Code::Unavailable,
        FailureKind::TimedOut => Code::DeadlineExceeded,
        FailureKind::Cancelled => Code::Cancelled,
        FailureKind::Internal => Code::Internal,
    }
}

/// What a failure is called that came about outside of our handlers.
pub(super) fn outcome(status: &Status) -> &'static str {
    match status.code() {
        // tonic's words for a message that does not end, and one that is none.
        Code::Unknown | Code::Internal if UNENDED.iter().any(|words| status.message().contains(words)) => "cancelled",
        Code::Unknown | Code::Internal if status.message().contains("decode") => "invalid_request",
        Code::Ok => "ok",
        Code::Cancelled => "cancelled",
        Code::InvalidArgument | Code::FailedPrecondition | Code::AlreadyExists | Code::Aborted => "invalid_request",
        Code::NotFound | Code::Unimplemented => "not_found",
        Code::OutOfRange => "too_large",
        Code::ResourceExhausted => "queue_full",
        Code::DeadlineExceeded => "timed_out",
        Code::Unavailable => "unavailable",
        Code::Unauthenticated => "unauthenticated",
        Code::PermissionDenied => "forbidden",
        Code::Unknown | Code::Internal | Code::DataLoss => "internal",
    }
}

impl From<Failure> for Status {
    /// With `google.rpc.ErrorInfo` (the code that JSON answers have), and `RetryInfo` where trying again is of use:
    /// `RESOURCE_EXHAUSTED` alone does not say it.
    fn from(failure: Failure) -> Self {
        let mut details = ErrorDetails::with_error_info(failure.kind.name(), "posed", []);
        if failure.kind == FailureKind::QueueFull {
            details.set_retry_info(Some(RETRY_DELAY));
        }
        Self::with_error_details(code(failure.kind), failure.message, details)
    }
}
