//! Statuses and reasons in answers.

use posed_core::pnp::Status;
use serde::Serialize;
use utoipa::ToSchema;

use crate::estimator::Reason;

/// How far you can trust a pose, from most to least trusted.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Status)]
pub enum StatusForm {
    /// The evidence agrees with the pose and with no other.
    Ok,
    /// Another pose explains the image about as well. See `alternatives`.
    Ambiguous,
    /// This is the best pose, but the evidence is thin.
    LowConfidence,
    /// The evidence contradicts the pose. Log it, but do not act on it.
    Rejected,
}

/// Reason for a status other than `ok`.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Reason)]
pub enum ReasonForm {
    /// Too few keypoints agree with the pose.
    FewInliers,
    /// The keypoints are further from the pose than their covariances allow.
    HighResidual,
    /// A second, very different pose fits the keypoints about as well.
    PlanarAmbiguity,
    /// The network sees most keypoints in two places, which make two poses. See the alternatives.
    TwoAnswers,
    /// The pose is not where the detector found the object.
    BoxMismatch,
    /// The network is unsure of most keypoints.
    WeakKeypoints,
    /// No pose puts the keypoints in front of the camera.
    NoPose,
    /// The pose is uncertain. See its covariance.
    UncertainPose,
    /// The object is nearer than it is large. Check that the camera's parameters belong to this image.
    TooNear,
    /// The principal point is far from the middle of the image, or the focal length is shorter than lenses have it. Check that the
    /// camera's parameters belong to this image, and are in pixels.
    CameraSuspect,
    /// The image has no colours, but the networks learned from colours.
    GreyImage,
    /// The image is nearly black.
    DarkImage,
    /// Too many poses with evidence like this one's are wrong. See `confidence`.
    Improbable,
    /// The network returned values that are not finite numbers, so there is no pose.
    NotFinite,
    /// For several views: a view contradicts the pose. The pose can be `ok` if most views agree.
    ViewsDisagree,
    /// For several views: the pose rests on one of them. It can be `ok`.
    SingleView,
    /// For several views: all look from nearly one direction, so that depth is known hardly better than from one. The pose can
    /// be `ok`.
    WeakBaseline,
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
            Reason::TwoAnswers => Self::TwoAnswers,
            Reason::BoxMismatch => Self::BoxMismatch,
            Reason::WeakKeypoints => Self::WeakKeypoints,
            Reason::NoPose => Self::NoPose,
            Reason::UncertainPose => Self::UncertainPose,
            Reason::TooNear => Self::TooNear,
            Reason::CameraSuspect => Self::CameraSuspect,
            Reason::GreyImage => Self::GreyImage,
            Reason::DarkImage => Self::DarkImage,
            Reason::Improbable => Self::Improbable,
            Reason::NotFinite => Self::NotFinite,
            Reason::ViewsDisagree => Self::ViewsDisagree,
            Reason::SingleView => Self::SingleView,
            Reason::WeakBaseline => Self::WeakBaseline,
        }
    }
}
