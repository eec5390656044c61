//! The forms in which requests come and answers leave. They know the service; it knows none of them.

pub mod json;
pub(crate) mod proto;
