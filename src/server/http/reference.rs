//! `PUT /v1/objects/{name}/reference`.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, Request, State};

use super::form::{self, Form};
use crate::server::api::json::{ErrorBody, ReferenceReport, ReferenceRequest};
use crate::server::service::{Failure, Recalibration, Service};

/// Measures an object's offset anew and puts it into force at once. Off unless the server allows it ('recalibration').
#[utoipa::path(
    put,
    path = "/v1/objects/{name}/reference",
    tag = "calibration",
    params(("name" = String, Path)),
    request_body(
        description = "Parts `image`, one for each reference image, and one part `request` (a `ReferenceRequest`)",
        content((ReferenceRequest = "multipart/form-data"))
    ),
    responses(
        (status = 200, description = "The reference now in force", body = ReferenceReport),
        (status = 400, description = "The form or one of its values cannot be used", body = ErrorBody),
        (status = 403, description = "The server does not allow it", body = ErrorBody),
        (status = 404, description = "Unknown object or camera", body = ErrorBody),
        (status = 422, description = "The object cannot be measured in an image, or the images contradict each other", body = ErrorBody),
        (status = 429, description = "There is no room now; see Retry-After", body = ErrorBody),
    )
)]
pub(super) async fn replace(
    State(service): State<Arc<Service>>,
    Path(object): Path<String>,
    request: Request,
) -> Result<Json<ReferenceReport>, Failure> {
    service.may_recalibrate(&object)?;
    let deadline = form::deadline(&service, request.headers())?;
    let body = form::lease(&request)?;
    let Form { images, request } = form::read_form::<ReferenceRequest>(&service, request, deadline).await?;
    let request = request.ok_or_else(|| Failure::invalid("no part 'request'; it holds the known poses"))?;
    let mode = request.mode;
    let views = request.views(images)?;
    let reference = service.recalibrate(Recalibration { object, views, mode, body, deadline }).await?;
    Ok(Json((&reference).into()))
}
