//! One message to one answer.

use std::sync::Arc;
use std::time::Instant;

use crate::estimator::BodyLease;
use crate::proto;
use crate::server::api::proto::{image, request, response};
use crate::server::service::{Failure, PoseWork, Service};

pub(super) async fn estimate(
    service: &Service,
    mut message: proto::EstimateRequest,
    body: Arc<BodyLease>,
    deadline: Instant,
) -> Result<proto::EstimateResponse, Failure> {
    let image = image(std::mem::take(&mut message.image), message.raw_image.take())?;
    let options = service.options(request(message)?)?;
    let answer = service.estimate(PoseWork { image, body, options: &options, guide: None, keep_image: false, deadline }).await?;
    Ok(response(&answer, &options, &service.models))
}
