//! `POST /v1/poses`.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, Request, State};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;

use super::form::{self, Form, ImageLimit, Kind};
use super::picture;
use super::query::EstimateQuery;
use super::upload::Admitted;
use crate::estimator::Answer;
use crate::server::api::json::{ErrorBody, EstimateRequest, Report, ReportContext};
use crate::server::service::{Failure, Options, PoseWork, Service};
use crate::vision::{Image, RawImage, RawLayout};

/// Returns the 6D poses of the known objects in one image.
///
/// The body is one of the following:
/// - An image (JPEG, PNG or WebP). Set the options in the query.
/// - A raw frame. Set the options in the query, with `encoding`, `width` and `height`.
/// - A form with the parts `image` and `request`. Set the options in `request`, as JSON. Use a form for cameras with
///   distortion and for poses in your own frames.
#[utoipa::path(
    post,
    path = "/v1/poses",
    tag = "poses",
    params(
        EstimateQuery,
        ("x-request-timeout-ms" = Option<u64>, Header, description = "Time limit for the answer, milliseconds"),
        ("accept" = Option<String>, Header, description = "`image/png` or `image/jpeg` for a picture instead of JSON"),
    ),
    request_body(
        description = "An image, a raw frame, or a form with the parts `image` and `request` (an `EstimateRequest`)",
        content(
            (Vec<u8> = "image/jpeg"), (Vec<u8> = "image/png"), (Vec<u8> = "image/webp"),
            (Vec<u8> = "application/octet-stream"), (EstimateRequest = "multipart/form-data"),
        )
    ),
    responses(
        (status = 200, description = "The poses; an empty list if no object is in view", body = Report),
        (status = 400, description = "The image, the camera or an option is not usable", body = ErrorBody),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 403, description = "The token lacks the scope", body = ErrorBody),
        (status = 404, description = "The camera or the object is unknown", body = ErrorBody),
        (status = 409, description = "A requested object is not calibrated", body = ErrorBody),
        (status = 413, description = "The body or the image exceeds a limit", body = ErrorBody),
        (status = 415, description = "The image format or the content type is not supported", body = ErrorBody),
        (
            status = 429,
            description = "The server is out of room, or the answer would come too late; retry after `Retry-After`",
            body = ErrorBody
        ),
        (status = 500, description = "The server failed on this image", body = ErrorBody),
        (status = 503, description = "All workers have failed or hang", body = ErrorBody),
        (status = 504, description = "The time limit expired, or the body stalled", body = ErrorBody),
    )
)]
pub(super) async fn poses(
    State(service): State<Arc<Service>>,
    query: Result<Query<EstimateQuery>, QueryRejection>,
    request: Request,
) -> Result<Response, Failure> {
    let Query(query) = query.map_err(|rejection| not_a_query(&rejection))?;
    let picture = picture::wanted(request.headers());
    let Admitted { body, deadline } = form::admitted(&request)?;
    let kind = if query.is_raw() { Kind::Image } else { Kind::of(request.headers())? };
    let (image, options) = match kind {
        Kind::Image => {
            let (asked, raw) = query.translate()?;
            let options = service.options(asked)?;
            (image(form::read_image(request, deadline).await?, raw)?, options)
        }
        Kind::Form if query == EstimateQuery::default() => one_image(&service, request, deadline).await?,
        Kind::Form => {
            return Err(Failure::invalid("set the options of a form in its part 'request', not in the query"));
        }
    };
    let work = PoseWork { image, body, options: &options, guide: None, keep_image: picture.is_some(), deadline };
    let answer = service.estimate(work).await?;
    match picture {
        Some(format) => picture::draw(answer, format).await,
        None => Ok(Json(report(&service, &answer, &options)).into_response()),
    }
}

/// Reads a form with one image.
async fn one_image(
    service: &Service,
    request: Request,
    deadline: std::time::Instant,
) -> Result<(Image, Options), Failure> {
    let Form { images, request } =
        form::read_form::<EstimateRequest>(ImageLimit::of_batch(service), request, deadline).await?;
    let (asked, raw) = request.unwrap_or_default().translate()?;
    let options = service.options(asked)?;
    let [bytes] = <[Bytes; 1]>::try_from(images)
        .map_err(|images| Failure::invalid(format!("{} parts 'image'; send exactly one", images.len())))?;
    Ok((image(bytes, raw)?, options))
}

/// A raw image if a layout is given, otherwise an encoded one.
pub(super) fn image(bytes: Bytes, raw: Option<RawLayout>) -> Result<Image, Failure> {
    let raw = raw.map(|layout| RawImage::new(layout, bytes.clone())).transpose();
    let raw = raw.map_err(|error| Failure::invalid(error.to_string()))?;
    Ok(raw.map_or(Image::Encoded(bytes), Image::Raw))
}

pub(super) fn report(service: &Service, answer: &Answer, options: &Options) -> Report {
    let captured_at = options.captured_at.as_deref();
    Report::new(answer, &ReportContext { provider: service.provider, frames: &options.frames, captured_at })
}

fn not_a_query(rejection: &QueryRejection) -> Failure {
    let text = rejection.body_text();
    let advice =
        if text.contains("duplicate field") { "; give it once, several values separated by commas" } else { "" };
    Failure::invalid(format!("{text}{advice}"))
}
