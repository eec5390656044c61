//! The body of every error.

use serde::Serialize;
use utoipa::ToSchema;

use crate::server::service::Failure;

/// The body of every error.
#[derive(Serialize, ToSchema)]
pub(crate) struct ErrorBody {
    pub error: ErrorDetail,
}

#[derive(Serialize, ToSchema)]
pub(crate) struct ErrorDetail {
    /// Error code, for programs.
    #[schema(example = "unknown_camera")]
    code: &'static str,
    /// Explanation, for people: what is wrong, which field or limit, and how to fix it.
    message: String,
}

impl From<&Failure> for ErrorBody {
    fn from(failure: &Failure) -> Self {
        Self { error: ErrorDetail { code: failure.kind.name(), message: failure.message.clone() } }
    }
}
