//! An answer as JSON.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use utoipa::ToSchema;

use posed_core::geometry::Pose;

use super::transform::{PlacedReport, TransformReport};
use super::trust::{ReasonForm, StatusForm};
use crate::estimator::{Answer, CallerFrames, ObjectPose, SolvedKeypoint, SolvedPose};
use crate::model::{Library, Provider};
use crate::vision::Exif;

/// What a report contains besides the estimate.
#[derive(Clone, Copy, Debug)]
pub struct ReportContext<'a> {
    /// What runs the networks.
    pub provider: Provider,
    /// Frames of the caller, in which poses are reported in addition to the camera frame.
    pub frames: &'a CallerFrames,
    /// The caller's label of the image.
    pub captured_at: Option<&'a str>,
}

/// The 6D poses of the objects in one image.
#[derive(Debug, Serialize, ToSchema)]
pub struct Report {
    /// The camera frame: OpenCV's optical frame.
    #[schema(example = "camera: x right, y down, z forward (OpenCV)")]
    pub frame: &'static str,
    #[schema(example = "metres, radians, pixels")]
    pub units: &'static str,
    /// Copy of `captured_at` of the request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captured_at: Option<String>,
    pub image: ImageReport,
    /// Sorted by status, then by confidence: the most trusted pose comes first.
    pub poses: Vec<PoseReport>,
    /// Whether objects may be missing, because the number of detections reached a limit: `max_detections` in
    /// `GET /v1/limits`, or the detector's own. Ask for fewer objects (`objects`), or raise `min_confidence`.
    pub truncated: bool,
    /// Why there is no pose of an object that was asked for by name, or no pose at all. Absent if there is nothing to say.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(example = json!(["mustard: not in the detector's labels; send its box ('boxes')"]))]
    pub hints: Vec<String>,
    pub timings_ms: TimingsReport,
    pub models: ModelsReport,
}

/// The image as decoded.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImageReport {
    pub width: u32,
    pub height: u32,
    /// Present if the image has an EXIF orientation other than "as stored".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exif: Option<ExifReport>,
    /// Size (width, height) that the camera is calibrated for. Present if the server scaled its parameters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_scaled_from: Option<[u32; 2]>,
}

/// An EXIF orientation other than "as stored".
#[derive(Debug, Serialize, ToSchema)]
pub struct ExifReport {
    /// EXIF orientation, 2 to 8.
    pub orientation: u8,
    /// Whether the server rotated the image. If true, the camera and all pixels refer to the rotated image, otherwise
    /// to the stored one.
    pub applied: bool,
}

/// One detected object. The fields of the pose are absent if no pose could be solved.
#[derive(Debug, Serialize, ToSchema)]
pub struct PoseReport {
    pub object: String,
    pub status: StatusForm,
    /// Reasons for a status other than `ok`.
    pub reasons: Vec<ReasonForm>,
    /// The probability that the pose is right: that its mean vertex error is below a tenth of the diameter. For models that do not
    /// state what their evidence is worth, the smallest of the detection score, the share of inliers among the keypoints, and
    /// `weight`. 0 for `rejected`.
    pub confidence: f64,
    pub detection: DetectionReport,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub solved: Option<SolvedReport>,
}

/// Where the object is: as the detector found it, or as the request says.
#[derive(Debug, Serialize, ToSchema)]
pub struct DetectionReport {
    /// Box of the visible part of the object: x, y, width, height in pixels.
    pub box_px: [f64; 4],
    /// Detector score, 0..1. 1 for a box of the request.
    pub score: f64,
    /// Place among the `boxes` of the request, from 0. Absent if a detector found the object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub given_box: Option<usize>,
}

/// A solved pose and its evidence.
#[derive(Debug, Serialize, ToSchema)]
pub struct SolvedReport {
    pub camera_from_object: TransformReport,
    /// 6x6 matrix, row-major: x, y, z (m²), rotation about x, y, z (rad²), along the axes of the camera frame, as in
    /// ROS `geometry_msgs/PoseWithCovariance`.
    pub covariance: [[f64; 6]; 6],
    /// Present if the request has `world_from_camera`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world_from_object: Option<PlacedReport>,
    /// Present if the request has `base_from_camera`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_from_object: Option<PlacedReport>,
    /// Root mean square reprojection error of the inliers.
    pub reprojection_rmse_px: f64,
    /// Number of keypoints that the pose is computed from.
    pub inliers: usize,
    pub keypoints: Vec<KeypointReport>,
    /// Number of keypoints beyond the domain of the lens model. The pose is computed without them.
    pub keypoints_outside_lens: usize,
    /// What the object's reference multiplies the coordinates of the virtual keypoints by. Present if it is not 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keypoints_scale: Option<f64>,
    /// Posterior weight of this pose relative to the alternatives, 0..1.
    pub weight: f64,
    /// Other poses that explain the image about as well.
    pub alternatives: Vec<AlternativeReport>,
}

/// One keypoint as found by the network.
#[derive(Debug, Serialize, ToSchema)]
pub struct KeypointReport {
    /// Position (u, v) in the posted image, pixels.
    pub pixel: [f64; 2],
    /// Distance from the projection of the pose. Absent if the keypoint or the projection is beyond the domain of the lens
    /// model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_px: Option<f64>,
    /// Probability mass around the keypoint, 0..1.
    pub peak: f64,
    /// Whether the pose is computed from this keypoint.
    pub inlier: bool,
}

/// Another pose that explains the image about as well.
#[derive(Debug, Serialize, ToSchema)]
pub struct AlternativeReport {
    pub camera_from_object: TransformReport,
    pub weight: f64,
}

/// Milliseconds spent in each stage. Images that the server processes together share the time of the keypoint nets.
#[derive(Debug, Serialize, ToSchema)]
pub struct TimingsReport {
    pub queue: f64,
    pub decode: f64,
    pub detect: f64,
    pub keypoints: f64,
    pub pnp: f64,
    pub total: f64,
    /// Number of images that the server processed together, including this one.
    pub batch_size: usize,
}

/// The networks that produced an answer.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelsReport {
    #[schema(value_type = String, example = "cpu")]
    pub provider: Provider,
    /// SHA-256 of the detector that objects share. Absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detector: Option<String>,
    /// SHA-256 of the detectors that objects bring along, by object name. Absent if there are none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub own_detectors: BTreeMap<String, String>,
    /// SHA-256 of the keypoint net of each object, by object name.
    pub keypoints: BTreeMap<String, String>,
}

impl ModelsReport {
    #[must_use]
    pub fn new(library: Option<&Library>, provider: Provider) -> Self {
        let shared = library.and_then(Library::shared_detector);
        Self {
            provider,
            detector: shared.map(|detector| detector.manifest.model_sha256.clone()),
            own_detectors: library.map(Library::own_detectors).unwrap_or_default(),
            keypoints: library.map(Library::keypoint_nets).unwrap_or_default(),
        }
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
            truncated: answer.estimate.truncated,
            hints: answer.estimate.hints.iter().map(ToString::to_string).collect(),
            timings_ms: TimingsReport {
                queue: milliseconds(answer.queued),
                decode: milliseconds(answer.decode),
                detect: milliseconds(timings.detect),
                keypoints: milliseconds(timings.keypoints),
                pnp: milliseconds(timings.pnp),
                total: milliseconds(answer.total),
                batch_size: answer.batch_size,
            },
            models: ModelsReport::new(Some(&*answer.estimate.catalogue.library), context.provider),
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
                given_box: found.detection.given,
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
            keypoints_outside_lens: solved.outside_lens,
            keypoints_scale: Some(solved.keypoints_scale).filter(|scale| (scale - 1.0).abs() > 0.0),
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
            residual_px: keypoint.residual_px.map(round),
            peak: round(keypoint.peak),
            inlier: keypoint.inlier,
        }
    }
}

/// Rounds to three decimals: further digits are noise.
pub(super) fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
