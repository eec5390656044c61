use serde::Serialize;

use super::problem::MAX_POINTS;
use crate::geometry::{Covariance6, Pose};

/// How far a pose can be trusted, the most trusted first: of two judgements the greater one holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// The evidence agrees with the pose and with no other.
    Ok,
    /// Another pose explains the image about as well; see the alternatives.
    Ambiguous,
    /// The best pose there is, on thin evidence.
    LowConfidence,
    /// The evidence contradicts the pose. It is given for logging, not for acting on.
    Rejected,
}

impl std::fmt::Display for Status {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.pad(match self {
            Self::Ok => "ok",
            Self::Ambiguous => "ambiguous",
            Self::LowConfidence => "low_confidence",
            Self::Rejected => "rejected",
        })
    }
}

/// Why a status is not `ok`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Too few keypoints agree with the pose.
    FewInliers,
    /// The keypoints scatter more about the pose than their covariances allow.
    HighResidual,
    /// A second pose, far from the first, has a comparable cost.
    PlanarAmbiguity,
    /// The keypoints of the pose do not lie where the detector saw the object.
    BoxMismatch,
    /// The network is unsure of most keypoints.
    WeakKeypoints,
    /// No pose puts the keypoints in front of the camera.
    NoPose,
    /// The evidence leaves the pose loose: see its covariance.
    UncertainPose,
}

/// The pose of one problem and everything known about its quality.
#[derive(Clone, Debug)]
pub struct Solution {
    /// `camera_from_points`.
    pub pose: Pose,
    /// Covariance of `pose`: inverse Hessian over the inliers times `max(1, chi2 / dof)`.
    pub covariance: Covariance6,
    /// Sum of the inliers' squared Mahalanobis distances.
    pub chi2: f64,
    /// `2 * inliers - 6`.
    pub degrees_of_freedom: usize,
    pub(super) inliers: [bool; MAX_POINTS],
    pub(super) points: usize,
    /// Posterior weight of `pose` among itself and the alternatives, 0..1.
    pub weight: f64,
    /// Other poses that were considered to the end, best first.
    pub alternatives: [Option<Alternative>; 2],
}

/// Another pose that explains the points, with its posterior weight.
#[derive(Clone, Copy, Debug)]
pub struct Alternative {
    pub pose: Pose,
    pub weight: f64,
}

impl Solution {
    /// One entry for each point: whether it lies within the 99 % ellipse of its reprojection.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        &self.inliers[..self.points]
    }

    #[must_use]
    pub fn inlier_count(&self) -> usize {
        self.inliers().iter().filter(|inlier| **inlier).count()
    }
}
