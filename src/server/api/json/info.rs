//! What the server knows, and its limits.

use std::time::Duration;

use serde::Serialize;
use utoipa::ToSchema;

use crate::model::{Method, Reference};
use crate::server::service::{KnownObject, Limits, MAX_JSON_BYTES, MemoryBound};
use crate::vision::{OrientationPolicy, RawEncoding};

/// A known object.
#[derive(Serialize, ToSchema)]
pub(crate) struct ObjectReport {
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
pub(crate) struct ReferenceReport {
    #[schema(value_type = String, example = "single")]
    method: Method,
    /// How exactly the offset is known: standard deviations over all axes.
    sigma_translation_m: f64,
    sigma_rotation_rad: f64,
    views: Vec<ReferenceViewReport>,
}

/// One reference image.
#[derive(Serialize, ToSchema)]
pub(crate) struct ReferenceViewReport {
    image: String,
    /// Whether the offset rests on it.
    inlier: bool,
    /// Distance from the offset of all.
    residual_deg: f64,
    residual_mm: f64,
}

/// What a request may ask for.
#[derive(Serialize, ToSchema)]
pub(crate) struct LimitsReport {
    /// Of a request in all.
    max_body_bytes: usize,
    /// Of the part `request` of a form.
    max_json_bytes: usize,
    max_side_px: u32,
    max_pixels: u64,
    max_batch_images: usize,
    /// Images in work or waiting.
    queue: usize,
    /// Bytes of bodies, from their announcement until they are answered.
    queue_bytes: usize,
    /// Bytes of decoded images, and of decoding.
    pixel_bytes: usize,
    timeout_ms: u64,
    max_timeout_ms: u64,
    /// A client that sends nothing of its body for so long is cut off.
    body_timeout_ms: u64,
    image_formats: [&'static str; 3],
    /// Of raw frames, as ROS names them.
    raw_encodings: Vec<String>,
    /// What happens to an image that asks to be turned.
    #[schema(value_type = String, example = "refuse")]
    exif_orientation: OrientationPolicy,
    memory: MemoryReport,
}

/// What the server's process takes at most, whatever its clients do.
#[derive(Serialize, ToSchema)]
pub(crate) struct MemoryReport {
    /// All of the following.
    bound_bytes: u64,
    /// Resident once the workers were warmed up.
    warm_bytes: u64,
    /// Bodies (`queue_bytes`).
    bodies_bytes: u64,
    /// Decoded images, and decoding (`pixel_bytes`).
    pixels_bytes: u64,
    /// Crops in the workers' hands.
    workers_bytes: u64,
    /// Buffers of connections.
    connections_bytes: u64,
}

impl From<&Limits> for LimitsReport {
    fn from(limits: &Limits) -> Self {
        let milliseconds = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        Self {
            max_body_bytes: limits.max_body_bytes,
            max_json_bytes: MAX_JSON_BYTES,
            max_side_px: limits.max_side_px,
            max_pixels: limits.max_pixels,
            max_batch_images: limits.max_batch_images,
            queue: limits.queue,
            queue_bytes: limits.queue_bytes,
            pixel_bytes: limits.pixel_bytes,
            timeout_ms: milliseconds(limits.timeout),
            max_timeout_ms: milliseconds(limits.max_timeout),
            body_timeout_ms: milliseconds(limits.body_timeout),
            image_formats: ["image/jpeg", "image/png", "image/webp"],
            raw_encodings: RawEncoding::ALL.iter().map(ToString::to_string).collect(),
            exif_orientation: limits.exif_orientation,
            memory: (&limits.memory).into(),
        }
    }
}

impl From<&MemoryBound> for MemoryReport {
    fn from(bound: &MemoryBound) -> Self {
        let MemoryBound { warm_bytes, bodies_bytes, pixels_bytes, workers_bytes, connections_bytes } = *bound;
        let bound_bytes = bound.total_bytes();
        Self { bound_bytes, warm_bytes, bodies_bytes, pixels_bytes, workers_bytes, connections_bytes }
    }
}

impl From<KnownObject<'_>> for ObjectReport {
    fn from(object: KnownObject<'_>) -> Self {
        let KnownObject { model, reference } = object;
        let manifest = &model.manifest;
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
