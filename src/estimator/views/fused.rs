use posed_core::geometry::{Covariance6, Pose};
use posed_core::views::Scale;

use crate::estimator::verdict::Verdict;

/// Where a camera stood.
#[derive(Clone, Copy, Debug)]
pub struct PosedCamera {
    pub world_from_camera: Pose,
    /// Covariance of a step of it along the world's axes; that of [`posed_core::views::ViewsOptions`] where it is not known.
    pub covariance: Option<Covariance6>,
}

/// One object in several views.
#[derive(Clone, Debug)]
pub struct FusedPose {
    pub object: String,
    pub verdict: Verdict,
    /// `world_from_object` and its covariance, the offset's uncertainty included once; `None` when no view has a pose.
    pub pose: Option<(Pose, Covariance6)>,
    /// The largest confidence of a view that the pose rests on, 0..1.
    pub confidence: f64,
    /// The views that the object was found in, in order.
    pub views: Vec<ViewShare>,
    /// Widest angle between the directions from which the pose is seen, radians.
    pub view_angle_rad: f64,
    /// How much larger the views show the virtual keypoints than they are said to be: see [`Scale`].
    pub scale: Option<Scale>,
    pub diameter_m: f64,
}

/// What one view has to do with a fused pose.
#[derive(Clone, Copy, Debug)]
pub struct ViewShare {
    /// The view.
    pub view: usize,
    /// The place of its own pose among its [`Estimate::poses`](crate::estimator::Estimate::poses).
    pub place: usize,
    /// Why the pose does not rest on it.
    pub left_out: Option<LeftOut>,
    /// Root mean square distance of its keypoints from the pose's projection, pixels, but for outliers of a view in use.
    pub residual_px: Option<f64>,
    pub inliers: usize,
    /// The fused pose as its camera sees it; without one, its own.
    pub camera_from_object: Option<Pose>,
}

/// Why a view has no part in a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftOut {
    /// Its keypoints are elsewhere than the other views put them.
    Contradicts,
    /// Its own pose is rejected, or there is none.
    Rejected,
    /// It looks from where a view in use looks from, and tells nothing of its own.
    NoBaseline,
}
