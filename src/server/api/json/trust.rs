//! Statuses and reasons as answers name them.

use posed_core::pnp::Status;
use serde::Serialize;
use utoipa::ToSchema;

use crate::estimator::Reason;

/// How far a pose can be trusted, the most trusted first.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Status)]
pub enum StatusForm {
    /// The evidence agrees with the pose and with no other.
    Ok,
    /// Another pose explains the image about as well; see the alternatives.
    Ambiguous,
    /// The best pose there is, on thin evidence.
    LowConfidence,
    /// The evidence contradicts the pose. It is given for logging, not for acting on.
    Rejected,
}

/// Why a status is not `ok`.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Reason)]
pub enum ReasonForm {
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

impl From<Status> for StatusForm {
    fn from(status: Status) -> Self {
        match status {
            Status::Ok => Self::Ok,
            Status::Ambiguous => Self::Ambiguous,
            Status::LowConfidence => Self::LowConfidence,
            Status::Rejected => Self::Rejected,
        }
    }
}

impl From<Reason> for ReasonForm {
    fn from(reason: Reason) -> Self {
        match reason {
            Reason::FewInliers => Self::FewInliers,
            Reason::HighResidual => Self::HighResidual,
            Reason::PlanarAmbiguity => Self::PlanarAmbiguity,
            Reason::BoxMismatch => Self::BoxMismatch,
            Reason::WeakKeypoints => Self::WeakKeypoints,
            Reason::NoPose => Self::NoPose,
            Reason::UncertainPose => Self::UncertainPose,
        }
    }
}
