//! What ties a request to what others know of it.

use axum::http::HeaderMap;
use uuid::Uuid;

pub(super) const REQUEST_ID: &str = "x-request-id";
pub(super) const TRACE_PARENT: &str = "traceparent";
const MAX_BYTES: usize = 128;

/// Kept in the log and in the answer.
pub(super) struct Marks {
    /// The caller's, or a new one.
    pub id: String,
    /// W3C trace context.
    pub trace_parent: Option<String>,
}

impl Marks {
    /// From the headers of either protocol: visible ASCII of bounded length, anything else is ignored.
    pub(super) fn of(headers: &HeaderMap) -> Self {
        let given = |name: &str| {
            let value = headers.get(name).filter(|value| value.len() <= MAX_BYTES)?;
            value.to_str().ok().map(ToOwned::to_owned)
        };
        let id = given(REQUEST_ID).filter(|id| !id.is_empty()).unwrap_or_else(|| Uuid::new_v4().to_string());
        Self { id, trace_parent: given(TRACE_PARENT) }
    }
}
