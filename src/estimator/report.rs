use serde::Serialize;

use super::pipeline::{ObjectPose, SolvedPose};
use super::queue::Answer;
use crate::geometry::{Covariance6, Pose};
use crate::pnp::{Reasons, Status};

/// An answer in the form that leaves the program as JSON.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Axes of every pose: OpenCV's optical frame.
    pub frame: &'static str,
    pub units: &'static str,
    pub image: ImageReport,
    pub poses: Vec<PoseReport>,
    pub timings_ms: TimingsReport,
}

#[derive(Debug, Serialize)]
pub struct ImageReport {
    pub width: u32,
    pub height: u32,
}

/// One detected object. Fields of the pose are absent when no pose could be solved.
#[derive(Debug, Serialize)]
pub struct PoseReport {
    pub object: String,
    pub status: Status,
    pub reasons: Reasons,
    pub detection: DetectionReport,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub solved: Option<SolvedReport>,
}

#[derive(Debug, Serialize)]
pub struct DetectionReport {
    /// Box of the visible part: x, y, width, height in pixels.
    pub box_px: [f64; 4],
    pub score: f64,
}

#[derive(Debug, Serialize)]
pub struct SolvedReport {
    pub camera_from_object: TransformReport,
    /// Row-major; x, y, z (m²), rotation about x, y, z (rad²), along the axes of the camera frame.
    pub covariance: [[f64; 6]; 6],
    pub reprojection_rmse_px: f64,
    pub inliers: usize,
    pub keypoints: usize,
    /// Posterior weight among the alternatives, 0..1.
    pub weight: f64,
    pub alternatives: Vec<AlternativeReport>,
}

#[derive(Debug, Serialize)]
pub struct AlternativeReport {
    pub camera_from_object: TransformReport,
    pub weight: f64,
}

/// A transform in both common forms.
#[derive(Debug, Serialize)]
pub struct TransformReport {
    pub rotation_xyzw: [f64; 4],
    pub translation_m: [f64; 3],
    /// Homogeneous, row-major.
    pub matrix: [[f64; 4]; 4],
}

#[derive(Debug, Serialize)]
pub struct TimingsReport {
    pub queue: f64,
    pub decode: f64,
    pub detect: f64,
    pub keypoints: f64,
    pub pose: f64,
    pub total: f64,
}

impl From<Answer> for Report {
    fn from(answer: Answer) -> Self {
        let Answer { estimate, queued, decode, total } = answer;
        let milliseconds = |duration: std::time::Duration| round(duration.as_secs_f64() * 1e3);
        Self {
            frame: "camera: x right, y down, z forward (OpenCV)",
            units: "metres, radians, pixels",
            image: ImageReport { width: estimate.width, height: estimate.height },
            poses: estimate.poses.into_iter().map(PoseReport::from).collect(),
            timings_ms: TimingsReport {
                queue: milliseconds(queued),
                decode: milliseconds(decode),
                detect: milliseconds(estimate.timings.detect),
                keypoints: milliseconds(estimate.timings.keypoints),
                pose: milliseconds(estimate.timings.pose),
                total: milliseconds(total),
            },
        }
    }
}

impl From<ObjectPose> for PoseReport {
    fn from(found: ObjectPose) -> Self {
        let region = found.detection.bounding_box;
        Self {
            object: found.object,
            status: found.verdict.status,
            reasons: found.verdict.reasons,
            detection: DetectionReport {
                box_px: [region.x, region.y, region.width, region.height].map(round),
                score: round(found.detection.score),
            },
            solved: found.pose.map(SolvedReport::from),
        }
    }
}

impl From<SolvedPose> for SolvedReport {
    fn from(solved: SolvedPose) -> Self {
        Self {
            camera_from_object: (&solved.camera_from_object).into(),
            covariance: rows(&solved.covariance),
            reprojection_rmse_px: round(solved.reprojection_rmse_px),
            inliers: solved.inliers,
            keypoints: solved.keypoints,
            weight: round(solved.weight),
            alternatives: solved
                .alternatives
                .iter()
                .map(|(pose, weight)| AlternativeReport { camera_from_object: pose.into(), weight: round(*weight) })
                .collect(),
        }
    }
}

impl From<&Pose> for TransformReport {
    fn from(pose: &Pose) -> Self {
        let matrix = pose.matrix();
        Self {
            rotation_xyzw: pose.rotation_xyzw(),
            translation_m: pose.translation_m(),
            matrix: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
        }
    }
}

fn rows(covariance: &Covariance6) -> [[f64; 6]; 6] {
    std::array::from_fn(|row| std::array::from_fn(|column| covariance[(row, column)]))
}

/// Figures for people: more digits would only be noise.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
