//! The forms in which requests come and answers leave.

pub mod json;
