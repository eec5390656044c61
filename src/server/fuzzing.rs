//! What fuzzers call: readers of requests that are nobody else's business.

use prost::Message as _;

use super::api::json::{BatchRequest, EstimateRequest, ReferenceRequest, ViewsForm, read_request};
use super::api::proto;

/// Reads the part `request` of a form, of every kind.
pub fn json_request(bytes: &[u8]) {
    if let Ok(request) = read_request::<EstimateRequest>(bytes) {
        drop(request.translate());
    }
    if let Ok(batch) = read_request::<BatchRequest>(bytes) {
        drop(batch.for_each(2));
    }
    if let Ok(request) = read_request::<ReferenceRequest>(bytes) {
        drop(request.views(vec![bytes::Bytes::new()]));
    }
    if let Ok(request) = read_request::<ViewsForm>(bytes) {
        drop(request.translate());
    }
}

/// Reads a form with the boundary `b`.
///
/// # Panics
/// When no runtime can be had.
pub fn form(bytes: &[u8]) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    runtime.block_on(super::http::fuzz_form(bytes));
}

/// Reads a message of the gRPC API.
pub fn protobuf_request(bytes: &[u8]) {
    if let Ok(message) = crate::proto::EstimateViewsRequest::decode(bytes) {
        drop(proto::views_request(message));
    }
    let Ok(mut message) = crate::proto::EstimateRequest::decode(bytes) else { return };
    drop(proto::image(std::mem::take(&mut message.image), message.raw_image.take()));
    drop(proto::request(message));
}
