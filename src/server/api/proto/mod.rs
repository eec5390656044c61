//! Requests and answers as protobuf messages.

mod answers;
mod requests;
mod tracks;
mod views;

pub(crate) use answers::{known_object, response};
pub(crate) use requests::{image, request};
pub(crate) use tracks::{follow_options, tracking};
pub(crate) use views::{views_request, views_response};
