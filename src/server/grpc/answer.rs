//! One message to one answer.

use std::sync::Arc;
use std::time::Instant;

use crate::estimator::BodyLease;
use crate::proto;
use crate::server::api::proto::{image, request, response, tracking, views_request, views_response};
use crate::server::service::{Failure, PoseWork, Service, TrackedStream, ViewsWork};

pub(super) async fn estimate(
    service: &Service,
    mut message: proto::EstimateRequest,
    body: Arc<BodyLease>,
    deadline: Instant,
) -> Result<proto::EstimateResponse, Failure> {
    let image = image(std::mem::take(&mut message.image), message.raw_image.take())?;
    let options = service.options(request(message)?)?;
    let answer =
        service.estimate(PoseWork { image, body, options: &options, guide: None, keep_image: false, deadline }).await?;
    Ok(response(&answer, &options, service.provider))
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
    Ok(views_response(&answer, captured_at, service.provider))
}

/// One frame of a stream that tracks.
pub(super) struct TrackedFrame {
    pub message: proto::EstimateRequest,
    pub capture_time: Option<f64>,
    pub body: Arc<BodyLease>,
    pub arrived: Instant,
    pub deadline: Instant,
}

pub(super) async fn estimate_tracked(
    service: &Service,
    stream: &mut TrackedStream,
    frame: TrackedFrame,
) -> Result<(proto::EstimateResponse, proto::Tracking), Failure> {
    let TrackedFrame { mut message, capture_time, body, arrived, deadline } = frame;
    let image = image(std::mem::take(&mut message.image), message.raw_image.take())?;
    let options = service.options(request(message)?)?;
    let next = stream.next(&options, capture_time, arrived)?;
    let guide = Some(&next.guide);
    let work = PoseWork { image, body, options: &options, guide, keep_image: false, deadline };
    let answer = service.estimate(work).await?;
    let tracks = stream.take(&next, &options, &answer.estimate)?;
    Ok((response(&answer, &options, service.provider), tracking(&tracks, &options.frames)))
}
