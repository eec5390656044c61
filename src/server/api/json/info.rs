//! Objects, cameras and limits of the server.

use std::time::{Duration, UNIX_EPOCH};

use posed_core::geometry::Camera;
use posed_core::views::Scale;
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

use super::forms::CameraForm;
use super::views::ScaleReport;
use crate::estimator::MAX_DETECTIONS;
use crate::model::{InForce, Method, PoseFile};
use crate::server::service::{KnownObject, Limits, MAX_JSON_BYTES, MemoryBound};
use crate::vision::{OrientationPolicy, RawEncoding};

/// An object that the server knows.
#[derive(Serialize, ToSchema)]
pub(crate) struct ObjectReport {
    name: String,
    /// Number of the object in BOP files.
    obj_id: u32,
    /// Whether the object has a reference. Without one the server returns no poses of it.
    calibrated: bool,
    /// Largest extent of the object, metres.
    diameter_m: f64,
    /// Number of virtual keypoints.
    keypoints: usize,
    /// Whether the object looks the same in several orientations. Answers then have the canonical one.
    symmetric: bool,
    /// Number of orientations in which the object looks the same, the one as it is among them.
    orientations: usize,
    /// Axis about which the object looks the same at any angle, in the frame of the object.
    #[serde(skip_serializing_if = "Option::is_none")]
    revolution_axis: Option<[f64; 3]>,
    /// SHA-256 of the keypoint net.
    model_sha256: String,
    /// What the trainer wrote about the keypoint net, such as its validation figures. For people; it has no fixed form.
    #[serde(skip_serializing_if = "Value::is_null")]
    #[schema(value_type = Option<Object>)]
    training: Value,
    #[serde(skip_serializing_if = "Option::is_none")]
    reference: Option<ReferenceReport>,
    /// Why the reference of the object is not in use. Present if there is one that is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_problem: Option<String>,
    /// SHA-256 of the detector that looks for the object. Absent if it is in no detector's labels: send its box (`boxes`).
    #[serde(skip_serializing_if = "Option::is_none")]
    detector_sha256: Option<String>,
}

/// The calibration of the object's frame.
#[derive(Serialize, ToSchema)]
pub(crate) struct ReferenceReport {
    /// SHA-256 of the reference file that is in force.
    sha256: String,
    /// When that file was written, seconds since 1970.
    modified_unix_s: u64,
    #[schema(value_type = String, example = "single")]
    method: Method,
    /// Uncertainty of the offset: standard deviations over all axes.
    sigma_translation_m: f64,
    sigma_rotation_rad: f64,
    /// What the coordinates of the virtual keypoints are multiplied by: 1 unless it was fitted (`fit_scale`, or
    /// `posed calibrate --fit-scale`).
    keypoints_scale: f64,
    /// What `keypoints_scale` would be if it were fitted to these references. Present in the answer that they are measured
    /// for, if at least three agree and look from different sides.
    #[serde(skip_serializing_if = "Option::is_none")]
    fitted_scale: Option<ScaleReport>,
    views: Vec<ReferenceViewReport>,
}

/// One reference image.
#[derive(Serialize, ToSchema)]
pub(crate) struct ReferenceViewReport {
    /// File name. `GET /v1/objects/{name}/reference/{image}` returns the image.
    image: String,
    #[schema(value_type = CameraForm)]
    camera: Camera,
    /// Pose of the object in this image.
    camera_from_object: ReferencePose,
    /// Box of the object in this image: x, y, width, height in pixels.
    box_px: [f64; 4],
    /// Whether the offset is computed from this image.
    inlier: bool,
    /// Difference between the offset in this image and the overall offset.
    residual_deg: f64,
    residual_mm: f64,
}

/// A pose as a reference states it.
#[derive(Serialize, ToSchema)]
pub(crate) struct ReferencePose {
    /// Unit quaternion x, y, z, w.
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
}

impl From<&PoseFile> for ReferencePose {
    fn from(file: &PoseFile) -> Self {
        Self { rotation_xyzw: file.rotation_xyzw, translation_m: file.translation_m }
    }
}

/// The limits of the server. Names are those of the settings.
#[derive(Serialize, ToSchema)]
pub(crate) struct LimitsReport {
    /// Maximum size of a request body.
    max_body_bytes: usize,
    /// Maximum size of the part `request` of a form.
    max_json_bytes: usize,
    /// Maximum size of the bundle of an object.
    max_bundle_bytes: usize,
    /// Maximum width and height of an image.
    max_side_px: u32,
    /// Maximum number of pixels of an image.
    max_pixels: u64,
    /// Maximum number of images in a request to `/v1/poses/batch`.
    max_batch_images: usize,
    /// Maximum number of images in a request to `/v1/poses/views`.
    max_views: usize,
    /// Maximum number of objects in one image. An answer that reached it has `truncated`.
    max_detections: usize,
    /// Maximum number of images that are waiting or in progress.
    queue: usize,
    /// Maximum size of all request bodies together. A body counts until its answer has left.
    queue_bytes: usize,
    /// Maximum memory for decoded images and for decoding.
    pixel_bytes: usize,
    /// Default time limit of a request.
    timeout_ms: u64,
    /// Maximum time limit that a request can set.
    max_timeout_ms: u64,
    /// Maximum time that a client can pause while it sends a body.
    body_timeout_ms: u64,
    /// Content types of encoded images.
    image_formats: [&'static str; 3],
    /// Encodings of raw frames, with their names in ROS.
    raw_encodings: Vec<String>,
    /// How the server treats images with an EXIF orientation: `refuse`, `apply` or `ignore`.
    #[schema(value_type = String, example = "refuse")]
    exif_orientation: OrientationPolicy,
    /// Whether `PUT /v1/objects/{name}/reference` is on.
    recalibration: bool,
    /// Whether `PUT` and `DELETE /v1/objects/{name}` are on.
    object_changes: bool,
    memory: MemoryReport,
}

/// Upper bound of the resident memory of the server process, whatever its clients do.
#[derive(Serialize, ToSchema)]
pub(crate) struct MemoryReport {
    /// Sum of the following.
    bound_bytes: u64,
    /// Resident memory after the start, or the last change of objects, with all networks loaded.
    warm_bytes: u64,
    /// Request bodies (twice `queue_bytes`: forms are copied once).
    bodies_bytes: u64,
    /// Decoded images and decoding (`pixel_bytes`).
    pixels_bytes: u64,
    /// Crops that the workers hold.
    workers_bytes: u64,
    /// Connection buffers (`max_connections`).
    connections_bytes: u64,
    /// An object that is being added (several times `max_bundle_bytes`). 0 without `object_changes`.
    object_changes_bytes: u64,
}

impl LimitsReport {
    pub(crate) fn new(limits: &Limits, memory: &MemoryBound) -> Self {
        let milliseconds = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        Self {
            max_body_bytes: limits.max_body_bytes,
            max_json_bytes: MAX_JSON_BYTES,
            max_bundle_bytes: limits.max_bundle_bytes,
            max_side_px: limits.max_side_px,
            max_pixels: limits.max_pixels,
            max_batch_images: limits.max_batch_images,
            max_views: limits.max_views,
            max_detections: MAX_DETECTIONS,
            queue: limits.queue,
            queue_bytes: limits.queue_bytes,
            pixel_bytes: limits.pixel_bytes,
            timeout_ms: milliseconds(limits.timeout),
            max_timeout_ms: milliseconds(limits.max_timeout),
            body_timeout_ms: milliseconds(limits.body_timeout),
            image_formats: ["image/jpeg", "image/png", "image/webp"],
            raw_encodings: RawEncoding::ALL.iter().map(ToString::to_string).collect(),
            exif_orientation: limits.exif_orientation,
            recalibration: limits.recalibration,
            object_changes: limits.object_changes,
            memory: memory.into(),
        }
    }
}

impl From<&MemoryBound> for MemoryReport {
    fn from(bound: &MemoryBound) -> Self {
        let MemoryBound {
            warm_bytes,
            bodies_bytes,
            pixels_bytes,
            workers_bytes,
            connections_bytes,
            object_changes_bytes,
        } = *bound;
        Self {
            bound_bytes: bound.total_bytes(),
            warm_bytes,
            bodies_bytes,
            pixels_bytes,
            workers_bytes,
            connections_bytes,
            object_changes_bytes,
        }
    }
}

impl From<KnownObject> for ObjectReport {
    fn from(object: KnownObject) -> Self {
        let KnownObject { model, reference, reference_problem, detector } = object;
        let manifest = &model.manifest;
        Self {
            name: manifest.name.clone(),
            obj_id: manifest.obj_id,
            calibrated: reference.is_some(),
            diameter_m: manifest.diameter_m,
            keypoints: manifest.virtual_keypoints_m.len(),
            symmetric: !model.symmetries.is_trivial(),
            orientations: model.symmetries.discrete().len(),
            revolution_axis: model.symmetries.continuous().first().map(|symmetry| (*symmetry.axis).into()),
            model_sha256: manifest.model_sha256.clone(),
            training: manifest.training.clone(),
            reference: reference.as_deref().map(ReferenceReport::from),
            reference_problem,
            detector_sha256: detector.map(|detector| detector.manifest.model_sha256.clone()),
        }
    }
}

impl ReferenceReport {
    /// Of a reference whose images were measured just now.
    pub(crate) fn measured(in_force: &InForce, fitted_scale: Option<Scale>) -> Self {
        let fitted_scale = fitted_scale.map(|scale| ScaleReport { value: scale.value, sigma: scale.sigma });
        Self { fitted_scale, ..in_force.into() }
    }
}

impl From<&InForce> for ReferenceReport {
    fn from(in_force: &InForce) -> Self {
        let InForce { reference, sha256, version, .. } = in_force;
        let (sigma_translation_m, sigma_rotation_rad) = reference.offset.sigmas();
        let views = reference.views.iter().map(|view| ReferenceViewReport {
            image: view.image.clone(),
            camera: view.camera.clone(),
            camera_from_object: (&view.camera_from_object).into(),
            box_px: view.box_px,
            inlier: view.inlier,
            residual_deg: view.residual_deg,
            residual_mm: view.residual_mm,
        });
        Self {
            sha256: sha256.clone(),
            modified_unix_s: version.modified.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs(),
            method: reference.method,
            sigma_translation_m,
            sigma_rotation_rad,
            keypoints_scale: reference.offset.keypoints_scale,
            fitted_scale: None,
            views: views.collect(),
        }
    }
}
