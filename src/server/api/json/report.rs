//! An answer in the form that leaves the program as JSON.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use utoipa::ToSchema;

use posed_core::geometry::Pose;

use super::transform::{PlacedReport, TransformReport};
use super::trust::{ReasonForm, StatusForm};
use crate::estimator::{Answer, CallerFrames, ObjectPose, SolvedKeypoint, SolvedPose};
use crate::model::{ModelsInUse, Provider};
use crate::vision::Exif;

/// What an answer says beside its poses.
#[derive(Clone, Copy, Debug)]
pub struct ReportContext<'a> {
    pub models: &'a ModelsInUse,
    /// Frames that the caller wants the poses in, beside the camera's.
    pub frames: &'a CallerFrames,
    /// The caller's own mark of the image.
    pub captured_at: Option<&'a str>,
}

/// The 6D poses of the objects in one image.
#[derive(Debug, Serialize, ToSchema)]
pub struct Report {
    /// Axes of every pose: OpenCV's optical frame.
    #[schema(example = "camera: x right, y down, z forward (OpenCV)")]
    pub frame: &'static str,
    #[schema(example = "metres, radians, pixels")]
    pub units: &'static str,
    /// As it was given with the request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captured_at: Option<String>,
    pub image: ImageReport,
    /// The most trusted first.
    pub poses: Vec<PoseReport>,
    pub timings_ms: TimingsReport,
    pub models: ModelsReport,
}

/// The image as it was read.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImageReport {
    pub width: u32,
    pub height: u32,
    /// How the file asks to be turned, where it does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exif: Option<ExifReport>,
    /// Width and height that the camera was calibrated for, where its parameters were scaled to this image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_scaled_from: Option<[u32; 2]>,
}

/// An EXIF orientation other than "as stored".
#[derive(Debug, Serialize, ToSchema)]
pub struct ExifReport {
    /// 2..=8.
    pub orientation: u8,
    /// Whether the image was turned, and the camera and all pixels mean the turned image; else they mean the stored one.
    pub applied: bool,
}

/// One detected object. Fields of the pose are absent when no pose could be solved.
#[derive(Debug, Serialize, ToSchema)]
pub struct PoseReport {
    pub object: String,
    pub status: StatusForm,
    /// Why the status is not `ok`.
    pub reasons: Vec<ReasonForm>,
    /// The weakest of detection score, share of agreeing keypoints, and weight among the alternatives; 0 where rejected.
    pub confidence: f64,
    pub detection: DetectionReport,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub solved: Option<SolvedReport>,
}

/// What the detector saw.
#[derive(Debug, Serialize, ToSchema)]
pub struct DetectionReport {
    /// Box of the visible part: x, y, width, height in pixels.
    pub box_px: [f64; 4],
    /// 0..1.
    pub score: f64,
}

/// A solved pose with what speaks for it.
#[derive(Debug, Serialize, ToSchema)]
pub struct SolvedReport {
    pub camera_from_object: TransformReport,
    /// 6x6, row-major; x, y, z (m²), rotation about x, y, z (rad²), along the axes of the camera frame, as in ROS
    /// `geometry_msgs/PoseWithCovariance`.
    pub covariance: [[f64; 6]; 6],
    /// Present where the request gave `world_from_camera`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world_from_object: Option<PlacedReport>,
    /// Present where the request gave `base_from_camera`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_from_object: Option<PlacedReport>,
    /// Root mean square distance of the agreeing keypoints from their projections.
    pub reprojection_rmse_px: f64,
    /// Number of keypoints that the pose rests on.
    pub inliers: usize,
    pub keypoints: Vec<KeypointReport>,
    /// Posterior weight among the alternatives, 0..1.
    pub weight: f64,
    /// Other poses that explain the image.
    pub alternatives: Vec<AlternativeReport>,
}

/// One keypoint as the network sees it.
#[derive(Debug, Serialize, ToSchema)]
pub struct KeypointReport {
    /// u, v in pixels of the posted image.
    pub pixel: [f64; 2],
    /// Distance from the pose's projection.
    pub residual_px: f64,
    /// Probability mass about the keypoint, 0..1.
    pub peak: f64,
    /// Whether the pose rests on it.
    pub inlier: bool,
}

/// Another pose that explains the image.
#[derive(Debug, Serialize, ToSchema)]
pub struct AlternativeReport {
    pub camera_from_object: TransformReport,
    pub weight: f64,
}

/// Milliseconds spent in each stage. Images that were worked on together share the time of the keypoint nets.
#[derive(Debug, Serialize, ToSchema)]
pub struct TimingsReport {
    pub queue: f64,
    pub decode: f64,
    pub detect: f64,
    pub keypoints: f64,
    pub pnp: f64,
    pub total: f64,
    /// Images that were worked on together.
    pub batch_size: usize,
}

/// Which networks answered, and what they ran on.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelsReport {
    #[schema(value_type = String, example = "cpu")]
    pub provider: Provider,
    /// SHA-256 of the detector's file.
    pub detector: String,
    /// SHA-256 of each object's keypoint net.
    pub keypoints: BTreeMap<String, String>,
}

impl From<&ModelsInUse> for ModelsReport {
    fn from(models: &ModelsInUse) -> Self {
        Self { provider: models.provider, detector: models.detector.clone(), keypoints: models.keypoints.clone() }
    }
}

impl Report {
    #[must_use]
    pub fn new(answer: &Answer, context: &ReportContext<'_>) -> Self {
        let milliseconds = |duration: Duration| round(duration.as_secs_f64() * 1e3);
        let timings = &answer.estimate.timings;
        Self {
            frame: "camera: x right, y down, z forward (OpenCV)",
            units: "metres, radians, pixels",
            captured_at: context.captured_at.map(ToOwned::to_owned),
            image: ImageReport {
                width: answer.estimate.width,
                height: answer.estimate.height,
                exif: Some(answer.exif)
                    .filter(|exif| exif.orientation != 1)
                    .map(|Exif { orientation, applied }| ExifReport { orientation, applied }),
                camera_scaled_from: answer.estimate.camera_scaled_from.map(|(width, height)| [width, height]),
            },
            poses: answer.estimate.poses.iter().map(|pose| PoseReport::new(pose, context.frames)).collect(),
            timings_ms: TimingsReport {
                queue: milliseconds(answer.queued),
                decode: milliseconds(answer.decode),
                detect: milliseconds(timings.detect),
                keypoints: milliseconds(timings.keypoints),
                pnp: milliseconds(timings.pnp),
                total: milliseconds(answer.total),
                batch_size: answer.batch_size,
            },
            models: context.models.into(),
        }
    }
}

impl PoseReport {
    fn new(found: &ObjectPose, frames: &CallerFrames) -> Self {
        let region = found.detection.bounding_box;
        Self {
            object: found.object.clone(),
            status: found.verdict.status.into(),
            reasons: found.verdict.reasons.iter().map(Into::into).collect(),
            confidence: round(found.confidence()),
            detection: DetectionReport {
                box_px: <[f64; 4]>::from(region).map(round),
                score: round(found.detection.score),
            },
            solved: found.pose.as_ref().map(|solved| SolvedReport::new(solved, frames)),
        }
    }
}

impl SolvedReport {
    fn new(solved: &SolvedPose, frames: &CallerFrames) -> Self {
        let placed = |frame: &Pose| PlacedReport::from(&solved.in_frame(frame));
        Self {
            camera_from_object: (&solved.camera_from_object).into(),
            covariance: solved.covariance.transpose().into(),
            world_from_object: frames.world_from_camera.as_ref().map(placed),
            base_from_object: frames.base_from_camera.as_ref().map(placed),
            reprojection_rmse_px: round(solved.reprojection_rmse_px),
            inliers: solved.inlier_count(),
            keypoints: solved.keypoints.iter().map(KeypointReport::from).collect(),
            weight: round(solved.weight),
            alternatives: solved
                .alternatives
                .iter()
                .map(|(pose, weight)| AlternativeReport { camera_from_object: pose.into(), weight: round(*weight) })
                .collect(),
        }
    }
}

impl From<&SolvedKeypoint> for KeypointReport {
    fn from(keypoint: &SolvedKeypoint) -> Self {
        Self {
            pixel: [keypoint.pixel.x, keypoint.pixel.y].map(round),
            residual_px: round(keypoint.residual_px),
            peak: round(keypoint.peak),
            inlier: keypoint.inlier,
        }
    }
}

/// Figures for people: more digits would only be noise.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
