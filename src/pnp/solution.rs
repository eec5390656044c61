use nalgebra::Vector2;
use serde::{Serialize, Serializer};
use utoipa::ToSchema;

use super::problem::MAX_POINTS;
use crate::geometry::{Covariance6, Pose};

/// How far a pose can be trusted, the most trusted first: of two judgements the greater one holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, ToSchema)]
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
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

impl std::fmt::Display for Reason {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.pad(match self {
            Self::FewInliers => "few_inliers",
            Self::HighResidual => "high_residual",
            Self::PlanarAmbiguity => "planar_ambiguity",
            Self::BoxMismatch => "box_mismatch",
            Self::WeakKeypoints => "weak_keypoints",
            Self::NoPose => "no_pose",
            Self::UncertainPose => "uncertain_pose",
        })
    }
}

/// Every reason, in the order in which they are reported.
const REASONS: [Reason; 7] = [
    Reason::PlanarAmbiguity,
    Reason::HighResidual,
    Reason::FewInliers,
    Reason::WeakKeypoints,
    Reason::BoxMismatch,
    Reason::UncertainPose,
    Reason::NoPose,
];

/// The reasons for a status: a set, serialised as a list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reasons(u8);

impl Reasons {
    /// Adds a reason; adding it again changes nothing.
    pub fn insert(&mut self, reason: Reason) {
        self.0 |= Self::bit(reason);
    }

    /// Whether a reason is among them.
    #[must_use]
    pub fn contains(self, reason: Reason) -> bool {
        self.0 & Self::bit(reason) != 0
    }

    /// Whether there is no reason.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The reasons, in the order in which they are reported.
    pub fn iter(self) -> impl Iterator<Item = Reason> {
        REASONS.into_iter().filter(move |reason| self.contains(*reason))
    }

    fn bit(reason: Reason) -> u8 {
        1 << reason as u8
    }
}

impl Serialize for Reasons {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

/// A judgement that others can only make worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// How far to trust the pose.
    pub status: Status,
    /// Why not further.
    pub reasons: Reasons,
}

impl Default for Verdict {
    fn default() -> Self {
        Self { status: Status::Ok, reasons: Reasons::default() }
    }
}

impl Verdict {
    /// Adds a reason and the least trust that it leaves.
    pub fn object(&mut self, reason: Reason, status: Status) {
        self.reasons.insert(reason);
        self.status = self.status.max(status);
    }
}

/// How well one point agrees with a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Residual {
    /// Projection minus observation, pixels. Not finite where the pose projects the point to no pixel.
    pub error_px: Vector2<f64>,
    /// Squared Mahalanobis distance.
    pub squared: f64,
    /// Within the 99.9 % ellipse of its covariance; the pose and its covariance rest on these points alone.
    pub inlier: bool,
}

/// The pose of one problem and everything known about its quality.
#[derive(Clone, Debug)]
pub struct Solution {
    /// `camera_from_points`.
    pub pose: Pose,
    /// Covariance of `pose`: the inverse Hessian over the inliers, times `chi2 / degrees_of_freedom` where that is
    /// improbably large (1 % of fits with true covariances), so that the stated covariances must have been too small.
    pub covariance: Covariance6,
    /// Sum of the inliers' squared Mahalanobis distances.
    pub chi2: f64,
    /// `2 * inliers - 6`.
    pub degrees_of_freedom: usize,
    pub(super) residuals: [Residual; MAX_POINTS],
    pub(super) points: usize,
    /// Posterior weight of `pose` among itself and the alternatives, 0..1.
    pub weight: f64,
    /// Other poses that were considered to the end, best first.
    pub alternatives: [Option<Alternative>; 2],
    /// What the points alone say of the pose.
    pub verdict: Verdict,
}

/// Another pose that explains the points, with its posterior weight.
#[derive(Clone, Copy, Debug)]
pub struct Alternative {
    /// `camera_from_points`.
    pub pose: Pose,
    /// As [`Solution::covariance`].
    pub covariance: Covariance6,
    /// Posterior weight, 0..1.
    pub weight: f64,
}

impl Solution {
    /// One entry for each point.
    #[must_use]
    pub fn residuals(&self) -> &[Residual] {
        &self.residuals[..self.points]
    }

    /// Number of points that the pose rests on.
    #[must_use]
    pub fn inlier_count(&self) -> usize {
        self.residuals().iter().filter(|residual| residual.inlier).count()
    }

    /// Root mean square reprojection error of the inliers, pixels.
    #[must_use]
    pub fn rmse_px(&self) -> f64 {
        let squares = self.residuals().iter().filter(|r| r.inlier).map(|r| r.error_px.norm_squared());
        (squares.sum::<f64>() / self.inlier_count().max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_only_get_worse_and_list_each_reason_once() {
        let mut verdict = Verdict::default();
        verdict.object(Reason::NoPose, Status::Rejected);
        verdict.object(Reason::HighResidual, Status::LowConfidence);
        verdict.object(Reason::HighResidual, Status::LowConfidence);
        assert_eq!(verdict.status, Status::Rejected);
        assert_eq!(serde_json::to_string(&verdict.reasons).unwrap(), r#"["high_residual","no_pose"]"#);
        for reason in REASONS {
            let mut reasons = Reasons::default();
            reasons.insert(reason);
            assert!(reasons.iter().eq([reason]));
        }
    }
}
