//! `POST /v1/poses`.

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, Request, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use image::ImageFormat;
use serde::Deserialize;
use utoipa::IntoParams;

use super::ErrorBody;
use super::body::{self, Form, Kind};
use crate::estimator::{Answer, CallerFrames, Selection};
use crate::server::api::json::{Report, ReportContext};
use crate::server::failure::{Failure, FailureKind};
use crate::server::request::{EstimateRequest, Options, invalid, registered_camera};
use crate::server::{App, Shared};
use crate::vision::encode;
use posed_core::geometry::Camera;

/// Options of a request whose body is an image.
#[derive(Debug, Default, Deserialize, PartialEq, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(default, deny_unknown_fields)]
pub(super) struct EstimateQuery {
    /// Id of a registered camera; else give `fx`, `fy`, `cx`, `cy`.
    camera: Option<String>,
    /// Focal lengths and principal point of a pinhole camera, pixels of the posted image.
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    /// Names of the objects to look for, with commas; all calibrated ones by default.
    objects: Option<String>,
    /// At most so many of each object.
    max_instances: Option<usize>,
    /// Poses with less confidence are left out, 0..1.
    min_confidence: Option<f64>,
    /// Your own mark of the image, given back as it is.
    captured_at: Option<String>,
}

/// The 6D poses of the known objects in one image.
///
/// The body is an image (JPEG, PNG or WebP; options in the query), or a form with the parts `image` and `request` (options
/// as JSON: cameras with distortion, your own frames).
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
        description = "An image, or the parts `image` and `request` (an `EstimateRequest`)",
        content((Vec<u8> = "image/jpeg"), (Vec<u8> = "image/png"), (Vec<u8> = "image/webp"), (EstimateRequest = "multipart/form-data"))
    ),
    responses(
        (status = 200, description = "Poses; nothing in view is an empty list", body = Report),
        (status = 400, description = "The image, the camera or an option cannot be used", body = ErrorBody),
        (status = 404, description = "Unknown camera or object", body = ErrorBody),
        (status = 409, description = "An object that was asked for is not calibrated", body = ErrorBody),
        (status = 413, description = "The body or the image is larger than a limit", body = ErrorBody),
        (status = 415, description = "Not a JPEG, PNG or WebP, or an unknown content type", body = ErrorBody),
        (status = 429, description = "The queue is full; see Retry-After", body = ErrorBody),
        (status = 500, description = "The server failed on this image", body = ErrorBody),
        (status = 504, description = "No answer in time", body = ErrorBody),
    )
)]
pub(super) async fn poses(
    State(app): State<App>,
    query: Result<Query<EstimateQuery>, QueryRejection>,
    request: Request,
) -> Result<Response, Failure> {
    let Query(query) = query.map_err(|rejection| invalid(&rejection.body_text()))?;
    let deadline = body::deadline(&app, request.headers())?;
    let picture = wanted_picture(request.headers());
    let (image, options) = match Kind::of(request.headers())? {
        Kind::Image => {
            let options = query.check(&app)?;
            (body::read_image(&app, request, deadline).await?, options)
        }
        Kind::Form if query == EstimateQuery::default() => {
            let Form { images, request } = body::read_form::<EstimateRequest>(&app, request, deadline).await?;
            let options = request.unwrap_or_default().check(&app)?;
            let [image] = <[Vec<u8>; 1]>::try_from(images)
                .map_err(|images| invalid(&format!("{} parts 'image'; one is needed", images.len())))?;
            (image, options)
        }
        Kind::Form => return Err(invalid("a form has its options in the part 'request', not in the query")),
    };
    let answer = app.estimate(image, &options, deadline, picture.is_some()).await?;
    match picture {
        Some(format) => draw(answer, format).await,
        None => Ok(Json(report(&app, &answer, &options)).into_response()),
    }
}

pub(super) fn report(app: &Shared, answer: &Answer, options: &Options) -> Report {
    let captured_at = options.captured_at.as_deref();
    Report::new(answer, &ReportContext { models: &app.models, frames: &options.frames, captured_at })
}

/// The first picture format that the caller accepts, if it names one.
fn wanted_picture(headers: &HeaderMap) -> Option<ImageFormat> {
    let accepted = headers.get(header::ACCEPT)?.to_str().ok()?;
    accepted.split(',').find_map(|range| match range.split(';').next().unwrap_or_default().trim() {
        "image/png" => Some(ImageFormat::Png),
        "image/jpeg" => Some(ImageFormat::Jpeg),
        _ => None,
    })
}

async fn draw(mut answer: Answer, format: ImageFormat) -> Result<Response, Failure> {
    let failed = |reason: String| {
        tracing::error!(reason, "the picture could not be drawn");
        Failure::new(FailureKind::Internal, "the picture could not be drawn; ask for JSON")
    };
    let mut image = answer.image.take().ok_or_else(|| failed("no pixels".into()))?;
    // Milliseconds of work, which must not hold up other requests.
    let drawn = tokio::task::spawn_blocking(move || {
        answer.estimate.draw(&mut image);
        encode(&image, format)
    });
    let bytes = drawn.await.map_err(|error| failed(error.to_string()))?.map_err(|error| failed(error.to_string()))?;
    Ok(([(header::CONTENT_TYPE, format.to_mime_type())], bytes).into_response())
}

impl EstimateQuery {
    fn check(self, app: &Shared) -> Result<Options, Failure> {
        let camera = match (self.camera, [self.fx, self.fy, self.cx, self.cy]) {
            (Some(id), [None, None, None, None]) => registered_camera(&id, app)?,
            (None, [Some(fx), Some(fy), Some(cx), Some(cy)]) => Camera::pinhole(fx, fy, cx, cy)?,
            (Some(_), _) => return Err(invalid("give either 'camera' or 'fx', 'fy', 'cx', 'cy', not both")),
            (None, _) => {
                return Err(invalid("no camera: give 'camera' (an id) or all of 'fx', 'fy', 'cx', 'cy' (pixels)"));
            }
        };
        let options = Options {
            camera,
            selection: Selection {
                objects: self.objects.map(|names| names.split(',').map(|name| name.trim().to_owned()).collect()),
                max_instances: self.max_instances,
                min_confidence: self.min_confidence.unwrap_or(0.0),
            },
            frames: CallerFrames::default(),
            captured_at: self.captured_at,
        };
        options.check(app)
    }
}
