//! Poses in answers.

use posed_core::geometry::{Covariance6, Pose};
use serde::Serialize;
use utoipa::ToSchema;

/// A transform, as quaternion with translation and as matrix.
#[derive(Debug, Serialize, ToSchema)]
pub struct TransformReport {
    /// Unit quaternion with w >= 0.
    pub rotation_xyzw: [f64; 4],
    pub translation_m: [f64; 3],
    /// Homogeneous 4x4 matrix, row-major.
    pub matrix: [[f64; 4]; 4],
}

/// A pose in one of your frames.
#[derive(Debug, Serialize, ToSchema)]
pub struct PlacedReport {
    #[serde(flatten)]
    pub transform: TransformReport,
    /// Covariance along the axes of your frame. Your transform is taken as exact.
    pub covariance: [[f64; 6]; 6],
}

impl From<&(Pose, Covariance6)> for PlacedReport {
    fn from((pose, covariance): &(Pose, Covariance6)) -> Self {
        Self { transform: pose.into(), covariance: covariance.transpose().into() }
    }
}

impl From<&Pose> for TransformReport {
    fn from(pose: &Pose) -> Self {
        Self {
            rotation_xyzw: pose.rotation_xyzw(),
            translation_m: pose.translation_m(),
            matrix: pose.matrix().transpose().into(),
        }
    }
}
