//! Every answer that is no success.

use serde::Serialize;
use utoipa::ToSchema;

use crate::server::service::Failure;

/// Every answer that is no success.
#[derive(Serialize, ToSchema)]
pub(crate) struct ErrorBody {
    pub error: ErrorDetail,
}

#[derive(Serialize, ToSchema)]
pub(crate) struct ErrorDetail {
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
