//! References: a new one, and the images of the one in force.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, Request, State};
use axum::http::header;
use axum::response::{IntoResponse as _, Response};

use super::form::{self, Form, ImageLimit};
use super::path::ObjectName;
use super::upload::Admitted;
use crate::server::api::json::{ErrorBody, ReferenceReport, ReferenceRequest};
use crate::server::body::Held;
use crate::server::service::{Failure, Recalibration, ReferenceImage, Service};

/// Measures the reference of an object and replaces it.
///
/// The new reference takes effect immediately. It keeps `keypoints_scale` of the one in force, unless `fit_scale` is set. The
/// server must run with `--recalibration`.
#[utoipa::path(
    put,
    path = "/v1/objects/{name}/reference",
    tag = "calibration",
    params(("name" = String, Path)),
    request_body(
        description = "A form with one part `image` for each reference image and one part `request` (a \
                       `ReferenceRequest`). With `clicks`, the first image of each pair is a reference image, and the \
                       second is not sent",
        content((ReferenceRequest = "multipart/form-data"))
    ),
    responses(
        (status = 200, description = "The new reference", body = ReferenceReport),
        (status = 400, description = "The form or one of its values is not usable", body = ErrorBody),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 403, description = "The server runs without `--recalibration`, or the token lacks the scope", body = ErrorBody),
        (status = 404, description = "The object or the camera is unknown", body = ErrorBody),
        (status = 413, description = "The body exceeds a limit, or has too many images", body = ErrorBody),
        (status = 415, description = "The body is not a form", body = ErrorBody),
        (status = 422, description = "The object cannot be measured in an image, or images disagree", body = ErrorBody),
        (
            status = 429,
            description = "The server is out of room, or the answer would come too late; retry after `Retry-After`",
            body = ErrorBody
        ),
        (status = 500, description = "The server failed on this request", body = ErrorBody),
        (status = 503, description = "All workers have failed or hang", body = ErrorBody),
        (status = 504, description = "No answer in time, or the body stalled", body = ErrorBody),
    )
)]
pub(super) async fn replace(
    State(service): State<Arc<Service>>,
    ObjectName(object): ObjectName,
    request: Request,
) -> Result<Json<ReferenceReport>, Failure> {
    service.may_recalibrate(&object)?;
    let Admitted { body, deadline } = form::admitted(&request)?;
    let Form { images, request } =
        form::read_form::<ReferenceRequest>(ImageLimit::of_batch(&service), request, deadline).await?;
    let request = request.ok_or_else(|| Failure::invalid("no part 'request'; send one with the known poses"))?;
    let ReferenceRequest { mode, far_origin, fit_scale, .. } = request;
    let views = request.views(images)?;
    let asked = Recalibration { object, views, mode, far_origin, fit_scale, body, deadline };
    let (reference, fitted_scale) = service.recalibrate(asked).await?;
    Ok(Json(ReferenceReport::measured(&reference, fitted_scale)))
}

/// Returns an image that the reference in force was measured on.
#[utoipa::path(
    get,
    path = "/v1/objects/{name}/reference/{image}",
    tag = "calibration",
    params(("name" = String, Path), ("image" = String, Path, description = "`image` of a view of the reference")),
    responses(
        (status = 200, description = "The file as it is", content((Vec<u8> = "image/jpeg"), (Vec<u8> = "image/png"), (Vec<u8> = "image/webp"))),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 404, description = "The object is unknown, or its reference has no such image", body = ErrorBody),
        (status = 429, description = "The server is out of room; retry after `Retry-After`", body = ErrorBody),
    )
)]
pub(super) async fn image(
    State(service): State<Arc<Service>>,
    names: Result<Path<(String, String)>, PathRejection>,
) -> Result<Response, Failure> {
    let Path((object, image)) = names.map_err(|rejection| Failure::invalid(rejection.body_text()))?;
    let ReferenceImage { bytes, content_type, room } = service.reference_image(&object, &image).await?;
    let held = Held::body(Body::from(bytes), room);
    Ok(([(header::CONTENT_TYPE, content_type), (header::X_CONTENT_TYPE_OPTIONS, "nosniff")], held).into_response())
}
