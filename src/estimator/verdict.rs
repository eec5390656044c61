//! How far an answer can be trusted, and why not further.

use posed_core::pnp::{Solution, Status};

/// Why a status is not `ok`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Too few keypoints agree with the pose.
    FewInliers,
    /// The keypoints scatter more about the pose than their covariances allow.
    HighResidual,
    /// A second pose, far from the first, has a comparable cost.
    PlanarAmbiguity,
    /// The network sees most keypoints in two places, which make two poses.
    TwoAnswers,
    /// The keypoints of the pose do not lie where the detector saw the object.
    BoxMismatch,
    /// The network is unsure of most keypoints.
    WeakKeypoints,
    /// No pose puts the keypoints in front of the camera.
    NoPose,
    /// The evidence leaves the pose loose: see its covariance.
    UncertainPose,
    /// The object would be nearer than it is large: the camera's parameters belong to another image.
    TooNear,
    /// The principal point is far from the image's middle, or the focal length shorter than lenses have it: the camera's
    /// parameters belong to another image, or are not in pixels.
    CameraSuspect,
    /// The image has no colours, and the networks learned from some.
    GreyImage,
    /// The image is nearly black.
    DarkImage,
    /// Of poses with such evidence too many are wrong.
    Improbable,
    /// The network returned values that are not finite numbers.
    NotFinite,
    /// Another view contradicts the pose.
    ViewsDisagree,
    /// The pose rests on one view of several.
    SingleView,
    /// All views look from nearly one direction.
    WeakBaseline,
}

impl std::fmt::Display for Reason {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.pad(match self {
            Self::FewInliers => "few_inliers",
            Self::HighResidual => "high_residual",
            Self::PlanarAmbiguity => "planar_ambiguity",
            Self::TwoAnswers => "two_answers",
            Self::BoxMismatch => "box_mismatch",
            Self::WeakKeypoints => "weak_keypoints",
            Self::NoPose => "no_pose",
            Self::UncertainPose => "uncertain_pose",
            Self::TooNear => "too_near",
            Self::CameraSuspect => "camera_suspect",
            Self::GreyImage => "grey_image",
            Self::DarkImage => "dark_image",
            Self::Improbable => "improbable",
            Self::NotFinite => "not_finite",
            Self::ViewsDisagree => "views_disagree",
            Self::SingleView => "single_view",
            Self::WeakBaseline => "weak_baseline",
        })
    }
}

/// Every reason, in the order in which they are reported.
const REASONS: [Reason; 17] = [
    Reason::PlanarAmbiguity,
    Reason::TwoAnswers,
    Reason::HighResidual,
    Reason::FewInliers,
    Reason::WeakKeypoints,
    Reason::BoxMismatch,
    Reason::UncertainPose,
    Reason::Improbable,
    Reason::TooNear,
    Reason::CameraSuspect,
    Reason::GreyImage,
    Reason::DarkImage,
    Reason::NoPose,
    Reason::NotFinite,
    Reason::ViewsDisagree,
    Reason::SingleView,
    Reason::WeakBaseline,
];

/// The reasons for a status: a set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reasons(u32);

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

    fn bit(reason: Reason) -> u32 {
        1 << reason as u8
    }
}

/// Reasons for which a track does not take a pose: there is no telling what the keypoints show.
const NOT_MEASURED: [Reason; 7] = [
    Reason::FewInliers,
    Reason::HighResidual,
    Reason::BoxMismatch,
    Reason::WeakKeypoints,
    Reason::UncertainPose,
    Reason::NoPose,
    Reason::NotFinite,
];

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
    /// What the solver says of its own pose.
    #[must_use]
    pub fn of(solution: &Solution) -> Self {
        let mut verdict = Self { status: solution.status, reasons: Reasons::default() };
        let doubts = solution.doubts;
        for (holds, reason) in [
            (doubts.planar_ambiguity, Reason::PlanarAmbiguity),
            (doubts.high_residual, Reason::HighResidual),
            (doubts.few_inliers, Reason::FewInliers),
        ] {
            if holds {
                verdict.reasons.insert(reason);
            }
        }
        verdict
    }

    /// Whether the pose is that of what the keypoints show. Doubts about the whole image, or between two poses, leave it so.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.status != Status::Rejected && !NOT_MEASURED.iter().any(|reason| self.reasons.contains(*reason))
    }

    /// Adds a reason and the least trust that it leaves.
    pub fn object(&mut self, reason: Reason, status: Status) {
        self.reasons.insert(reason);
        self.status = self.status.max(status);
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
        assert!(verdict.reasons.iter().eq([Reason::HighResidual, Reason::NoPose]));
        for reason in REASONS {
            let mut reasons = Reasons::default();
            reasons.insert(reason);
            assert!(reasons.iter().eq([reason]));
        }
    }
}
