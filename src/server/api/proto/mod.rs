//! Requests and answers as protobuf messages.

mod answers;
mod requests;

pub(crate) use answers::{known_object, response};
pub(crate) use requests::{image, request};
