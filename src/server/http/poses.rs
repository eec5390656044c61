//! `POST /v1/poses`.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, Request, State};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;

use super::form::{self, Form, Kind};
use super::picture;
use super::query::EstimateQuery;
use crate::estimator::Answer;
use crate::server::api::json::{ErrorBody, EstimateRequest, Report, ReportContext};
use crate::server::service::{Failure, Options, PoseWork, Service};
use crate::vision::{Image, RawImage, RawLayout};

/// The 6D poses of the known objects in one image.
///
/// The body is an image (JPEG, PNG or WebP; options in the query), a raw frame (`encoding`, `width` and `height` in the
/// query, too), or a form with the parts `image` and `request` (options as JSON: cameras with distortion, your own frames).
#[utoipa::path(
    post,
    path = "/v1/poses",
    tag = "poses",
    params(
        EstimateQuery,
        ("x-request-timeout-ms" = Option<u64>, Header, description = "Time for the answer, within the server's limit"),
        ("accept" = Option<String>, Header, description = "`image/png` or `image/jpeg`: the picture of the answer"),
    ),
    request_body(
        description = "An image, a raw frame, or the parts `image` and `request` (an `EstimateRequest`)",
        content(
            (Vec<u8> = "image/jpeg"), (Vec<u8> = "image/png"), (Vec<u8> = "image/webp"),
            (Vec<u8> = "application/octet-stream"), (EstimateRequest = "multipart/form-data"),
        )
    ),
    responses(
        (status = 200, description = "Poses; nothing in view is an empty list", body = Report),
        (status = 400, description = "The image, the camera or an option cannot be used", body = ErrorBody),
        (status = 404, description = "Unknown camera or object", body = ErrorBody),
        (status = 409, description = "An object that was asked for is not calibrated", body = ErrorBody),
        (status = 413, description = "The body or the image is larger than a limit", body = ErrorBody),
        (status = 415, description = "Not a JPEG, PNG or WebP, or an unknown content type", body = ErrorBody),
        (status = 429, description = "There is no room now; see Retry-After", body = ErrorBody),
        (status = 500, description = "The server failed on this image", body = ErrorBody),
        (status = 504, description = "No answer in time", body = ErrorBody),
    )
)]
pub(super) async fn poses(
    State(service): State<Arc<Service>>,
    query: Result<Query<EstimateQuery>, QueryRejection>,
    request: Request,
) -> Result<Response, Failure> {
    let Query(query) = query.map_err(|rejection| Failure::invalid(rejection.body_text()))?;
    let deadline = form::deadline(&service, request.headers())?;
    let picture = picture::wanted(request.headers());
    let body = form::lease(&request)?;
    let kind = if query.is_raw() { Kind::Image } else { Kind::of(request.headers())? };
    let (image, options) = match kind {
        Kind::Image => {
            let (asked, raw) = query.translate()?;
            let options = service.options(asked)?;
            (image(form::read_image(request, deadline).await?, raw)?, options)
        }
        Kind::Form if query == EstimateQuery::default() => one_image(&service, request, deadline).await?,
        Kind::Form => return Err(Failure::invalid("a form has its options in the part 'request', not in the query")),
    };
    let work = PoseWork { image, body, options: &options, keep_image: picture.is_some(), deadline };
    let answer = service.estimate(work).await?;
    match picture {
        Some(format) => picture::draw(answer, format).await,
        None => Ok(Json(report(&service, &answer, &options)).into_response()),
    }
}

/// A form's only image and its options.
async fn one_image(
    service: &Service,
    request: Request,
    deadline: std::time::Instant,
) -> Result<(Image, Options), Failure> {
    let Form { images, request } = form::read_form::<EstimateRequest>(service, request, deadline).await?;
    let (asked, raw) = request.unwrap_or_default().translate()?;
    let options = service.options(asked)?;
    let [bytes] = <[Bytes; 1]>::try_from(images)
        .map_err(|images| Failure::invalid(format!("{} parts 'image'; one is needed", images.len())))?;
    Ok((image(bytes, raw)?, options))
}

/// Encoded, unless a layout says that it is raw.
pub(super) fn image(bytes: Bytes, raw: Option<RawLayout>) -> Result<Image, Failure> {
    let raw = raw.map(|layout| RawImage::new(layout, bytes.clone())).transpose();
    let raw = raw.map_err(|error| Failure::invalid(error.to_string()))?;
    Ok(raw.map_or(Image::Encoded(bytes), Image::Raw))
}

pub(super) fn report(service: &Service, answer: &Answer, options: &Options) -> Report {
    let captured_at = options.captured_at.as_deref();
    Report::new(answer, &ReportContext { models: &service.models, frames: &options.frames, captured_at })
}
