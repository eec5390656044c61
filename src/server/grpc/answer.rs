//! One message to one answer.

use std::sync::Arc;
use std::time::Instant;

use crate::estimator::BodyLease;
use crate::proto;
use crate::server::api::proto::{image, request, response, views_request, views_response};
use crate::server::service::{Failure, PoseWork, Service, ViewsWork};

pub(super) async fn estimate(
    service: &Service,
    mut message: proto::EstimateRequest,
    body: Arc<BodyLease>,
    deadline: Instant,
) -> Result<proto::EstimateResponse, Failure> {
    let image = image(std::mem::take(&mut message.image), message.raw_image.take())?;
    let options = service.options(request(message)?)?;
    let answer = service.estimate(PoseWork { image, body, options: &options, keep_image: false, deadline }).await?;
    Ok(response(&answer, &options, &service.models))
}

pub(super) async fn estimate_views(
    service: &Arc<Service>,
    message: proto::EstimateViewsRequest,
    body: Arc<BodyLease>,
    deadline: Instant,
) -> Result<proto::EstimateViewsResponse, Failure> {
    service.check_view_count(message.views.len())?;
    let (request, images) = views_request(message)?;
    let checked = service.views(request, images.len())?;
    let captured_at = checked.captured_at.clone();
    let answer = service.estimate_views(ViewsWork { images, body, checked, keep_images: false, deadline }).await?;
    Ok(views_response(&answer, captured_at, &service.models))
}
