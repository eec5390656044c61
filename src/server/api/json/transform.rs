//! Poses in answers.

use posed_core::geometry::{Covariance6, Pose};
use serde::Serialize;
use utoipa::ToSchema;

/// A transform in both common forms.
#[derive(Debug, Serialize, ToSchema)]
pub struct TransformReport {
    /// Unit, w >= 0.
    pub rotation_xyzw: [f64; 4],
    pub translation_m: [f64; 3],
    /// Homogeneous, row-major.
    pub matrix: [[f64; 4]; 4],
}

/// A pose in a frame of the caller.
#[derive(Debug, Serialize, ToSchema)]
pub struct PlacedReport {
    #[serde(flatten)]
    pub transform: TransformReport,
    /// Along the axes of the caller's frame. The caller's own transform counts as exact.
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
