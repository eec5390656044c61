//! Parts of paths.

use axum::extract::{FromRequestParts, Path};
use axum::http::request::Parts;

use crate::server::service::Failure;

/// The name of an object, from the path.
pub(super) struct ObjectName(pub String);

impl<S: Send + Sync> FromRequestParts<S> for ObjectName {
    type Rejection = Failure;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Failure> {
        let name = Path::<String>::from_request_parts(parts, state).await;
        name.map(|Path(name)| Self(name)).map_err(|rejection| Failure::invalid(rejection.body_text()))
    }
}
