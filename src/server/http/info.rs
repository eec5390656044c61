//! What the server knows: objects, cameras, limits.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Path, State};
use serde::Serialize;
use utoipa::ToSchema;

use super::ErrorBody;
use crate::model::{Method, ObjectModel, Reference};
use crate::server::api::json::CameraForm;
use crate::server::failure::Failure;
use crate::server::request::known_object;
use crate::server::{App, Shared};
use crate::vision::OrientationPolicy;
use posed_core::geometry::Camera;

/// A known object.
#[derive(Serialize, ToSchema)]
pub(super) struct ObjectReport {
    name: String,
    /// The object's number in BOP files.
    obj_id: u32,
    /// Whether its poses can be given.
    calibrated: bool,
    /// Largest extent, metres.
    diameter_m: f64,
    /// Number of virtual keypoints.
    keypoints: usize,
    /// Whether several of its orientations look the same: then the answer is canonical.
    symmetric: bool,
    /// SHA-256 of the keypoint net.
    model_sha256: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    reference: Option<ReferenceReport>,
}

/// How the object's frame was measured.
#[derive(Serialize, ToSchema)]
pub(super) struct ReferenceReport {
    #[schema(value_type = String, example = "single")]
    method: Method,
    /// How exactly the offset is known: standard deviations over all axes.
    sigma_translation_m: f64,
    sigma_rotation_rad: f64,
    views: Vec<ReferenceViewReport>,
}

/// One reference image.
#[derive(Serialize, ToSchema)]
pub(super) struct ReferenceViewReport {
    image: String,
    /// Whether the offset rests on it.
    inlier: bool,
    /// Distance from the offset of all.
    residual_deg: f64,
    residual_mm: f64,
}

/// Every known object, calibrated or not.
#[utoipa::path(get, path = "/v1/objects", tag = "info", responses((status = 200, body = Vec<ObjectReport>)))]
pub(super) async fn objects(State(app): State<App>) -> Json<Vec<ObjectReport>> {
    Json(app.library.known().map(|object| ObjectReport::new(object, &app)).collect())
}

/// One known object.
#[utoipa::path(
    get,
    path = "/v1/objects/{name}",
    tag = "info",
    params(("name" = String, Path)),
    responses((status = 200, body = ObjectReport), (status = 404, description = "Unknown object", body = ErrorBody))
)]
pub(super) async fn object(State(app): State<App>, Path(name): Path<String>) -> Result<Json<ObjectReport>, Failure> {
    Ok(Json(ObjectReport::new(known_object(&name, &app)?, &app)))
}

/// Every registered camera, by id.
#[utoipa::path(get, path = "/v1/cameras", tag = "info", responses((status = 200, body = BTreeMap<String, CameraForm>)))]
pub(super) async fn cameras(State(app): State<App>) -> Json<BTreeMap<String, Camera>> {
    Json(app.cameras.iter().map(|(id, camera)| (id.to_owned(), camera.clone())).collect())
}

/// What a request may ask for.
#[derive(Serialize, ToSchema)]
pub(super) struct LimitsReport {
    max_body_bytes: usize,
    max_side_px: u32,
    max_pixels: u64,
    max_batch_images: usize,
    /// Images in work or waiting.
    queue: usize,
    queue_bytes: usize,
    timeout_ms: u64,
    max_timeout_ms: u64,
    image_formats: [&'static str; 3],
    /// What happens to an image that asks to be turned.
    #[schema(value_type = String, example = "refuse")]
    exif_orientation: OrientationPolicy,
}

/// The limits that requests are held to.
#[utoipa::path(get, path = "/v1/limits", tag = "info", responses((status = 200, body = LimitsReport)))]
pub(super) async fn limits(State(app): State<App>) -> Json<LimitsReport> {
    let config = &app.config;
    Json(LimitsReport {
        max_body_bytes: config.max_body_bytes,
        max_side_px: config.max_side_px,
        max_pixels: config.max_pixels,
        max_batch_images: config.max_batch_images,
        queue: config.queue,
        queue_bytes: config.queue_bytes,
        timeout_ms: config.timeout_ms,
        max_timeout_ms: config.max_timeout_ms,
        image_formats: ["image/jpeg", "image/png", "image/webp"],
        exif_orientation: config.exif_orientation,
    })
}

impl ObjectReport {
    fn new(object: &ObjectModel, app: &Shared) -> Self {
        let manifest = &object.manifest;
        let reference = app.references.get(&manifest.name);
        Self {
            name: manifest.name.clone(),
            obj_id: manifest.obj_id,
            calibrated: reference.is_some(),
            diameter_m: manifest.diameter_m,
            keypoints: manifest.virtual_keypoints_m.len(),
            symmetric: !(manifest.symmetries_discrete.is_empty() && manifest.symmetries_continuous.is_empty()),
            model_sha256: manifest.model_sha256.clone(),
            reference: reference.as_deref().map(ReferenceReport::from),
        }
    }
}

impl From<&Reference> for ReferenceReport {
    fn from(reference: &Reference) -> Self {
        let (sigma_translation_m, sigma_rotation_rad) = reference.offset.sigmas();
        let views = reference.views.iter().map(|view| ReferenceViewReport {
            image: view.image.clone(),
            inlier: view.inlier,
            residual_deg: view.residual_deg,
            residual_mm: view.residual_mm,
        });
        Self { method: reference.method, sigma_translation_m, sigma_rotation_rad, views: views.collect() }
    }
}
