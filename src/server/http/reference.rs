//! `PUT /v1/objects/{name}/reference`.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, Request, State};
use serde::Deserialize;
use utoipa::ToSchema;

use super::ErrorBody;
use super::body::{self, Form};
use super::info::ReferenceReport;
use crate::estimator::{MeasuredView, ReferenceWork, calibrate};
use crate::model::{ObjectModel, Reference};
use crate::server::api::json::PoseForm;
use crate::server::failure::{Failure, FailureKind};
use crate::server::request::{CameraChoice, choose_camera, invalid, known_object, pose};
use crate::server::{App, Shared};
use crate::vision::BoundingBox;
use posed_core::calibration::Mode;

/// The part `request` of a recalibration. Unknown fields are refused.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ReferenceRequest {
    /// One entry for each part `image`, in order.
    references: Vec<ReferenceImage>,
    /// `weighted` (default) or `paper`: how several images become one offset.
    #[serde(default)]
    #[schema(value_type = String, example = "weighted")]
    mode: Mode,
}

/// What is known of one reference image.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct ReferenceImage {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoice)]
    camera: serde_json::Value,
    /// The object's pose in this image.
    camera_from_object: PoseForm,
    /// The object's box: x, y, width, height in pixels. By default the only one that the detector sees.
    box_px: Option<[f64; 4]>,
}

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
    )
)]
pub(super) async fn replace(
    State(app): State<App>,
    Path(name): Path<String>,
    request: Request,
) -> Result<Json<ReferenceReport>, Failure> {
    if !app.config.recalibration {
        let message =
            "this server does not replace references; start it with --recalibration, or use `posed calibrate`";
        return Err(Failure::new(FailureKind::Forbidden, message));
    }
    let object = known_object(&name, &app)?;
    let deadline = body::deadline(&app, request.headers())?;
    let Form { images, request } = body::read_form::<ReferenceRequest>(&app, request, deadline).await?;
    let request = request.ok_or_else(|| invalid("no part 'request'; it holds the known poses"))?;
    if images.is_empty() || images.len() != request.references.len() {
        let (images, references) = (images.len(), request.references.len());
        return Err(invalid(&format!("{images} parts 'image' for {references} entries in 'references'")));
    }
    let _one_at_a_time = app.recalibrating.lock().await;
    let mut views = Vec::with_capacity(images.len());
    let mut files = Vec::with_capacity(images.len());
    for (index, (image, known)) in images.into_iter().zip(&request.references).enumerate() {
        let file = file_name(&name, index, &image);
        let camera = choose_camera(&known.camera, &app)?;
        let camera_from_object = pose("camera_from_object", known.camera_from_object)?;
        let region = known.box_px.map(BoundingBox::from);
        let work =
            ReferenceWork { image: image.clone(), camera: camera.clone(), object: name.clone(), region, deadline };
        let (region, solution) = app.queue.measure(work).await?;
        views.push(MeasuredView { file: file.clone(), camera, camera_from_object, region, solution });
        files.push((file, image));
    }
    put_into_force(&app, object, views, files, request.mode).await.map(|reference| Json((&reference).into()))
}

async fn put_into_force(
    app: &Arc<Shared>,
    object: &ObjectModel,
    views: Vec<MeasuredView>,
    files: Vec<(String, Vec<u8>)>,
    mode: Mode,
) -> Result<Reference, Failure> {
    let reference = calibrate(object, views, mode)?;
    let (references, new) = (Arc::clone(&app.references), reference.clone());
    let written = tokio::task::spawn_blocking(move || references.replace(new, &files)).await;
    let failed = |error: String| {
        tracing::error!(error, "a reference could not be written");
        Failure::new(FailureKind::Internal, format!("{error}; the old reference stays in force"))
    };
    written.map_err(|error| failed(error.to_string()))?.map_err(|error| failed(error.to_string()))?;
    tracing::info!("{} has a new reference", reference.object);
    Ok(reference)
}

fn file_name(object: &str, index: usize, image: &[u8]) -> String {
    let format = image::guess_format(image).ok();
    let extension = format.and_then(|format| format.extensions_str().first().copied()).unwrap_or("jpg");
    format!("{object}-{index}.{extension}")
}
