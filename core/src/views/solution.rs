use crate::geometry::{Covariance6, Pose};
use crate::pnp::Status;

/// The pose that several views agree in.
#[derive(Clone, Debug)]
pub struct ViewsSolution {
    /// The pose in the world.
    pub world_from_points: Pose,
    /// Of a step along the world's axes: the inverse Hessian over the inliers, widened where their residuals are improbably
    /// large, as [`crate::pnp::Solution::covariance`].
    pub covariance: Covariance6,
    /// Inliers' squared Mahalanobis distances, and those of the views' own steps.
    pub chi2: f64,
    /// `2 * inliers - 6`, where views from one direction count as one.
    pub degrees_of_freedom: f64,
    /// One for each view, in their order.
    pub views: Vec<ViewFit>,
    /// Widest angle between the directions from which the object is seen, radians.
    pub view_angle_rad: f64,
    /// Another pose that explains the views, with its weight beside this one, 0..1.
    pub alternative: Option<(Pose, f64)>,
    /// The common factor of the points' distances that would fit the views best: a hint, which changes nothing here. `None`
    /// with fewer than three views in use, or where they look from nearly one direction.
    pub scale: Option<Scale>,
    /// How far the views alone let the pose be trusted.
    pub status: Status,
    /// Why not further.
    pub doubts: Doubts,
}

/// How much larger the object is than its points say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// 1 where they are right.
    pub value: f64,
    /// Standard deviation of `value`.
    pub sigma: f64,
}

impl Scale {
    /// How many standard deviations it differs by from another scale.
    #[must_use]
    pub fn sigmas_from(&self, other: f64) -> f64 {
        (self.value - other).abs() / self.sigma
    }
}

/// What one view has to do with the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFit {
    /// Why the pose does not rest on this view.
    pub excluded: Option<Exclusion>,
    /// Root mean square distance of the view's points from the pose's projection, pixels, over those that are no outliers;
    /// over all, where the view is excluded. `None` where the pose is behind the camera.
    pub residual_px: Option<f64>,
    /// Points that the pose rests on.
    pub inliers: usize,
    /// The pose of which the view saw the points: one that looks the same, turned by a symmetry.
    pub world_from_points: Pose,
}

/// Why a view is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exclusion {
    /// Its points are elsewhere than the other views put them.
    Contradicts,
}

/// What speaks against a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "a list of what may hold")]
pub struct Doubts {
    /// A view contradicts the others, and is left out.
    pub views_disagree: bool,
    /// No more views agree than contradict.
    pub no_majority: bool,
    /// All views look from nearly one direction: depth is known hardly better than from one.
    pub weak_baseline: bool,
    /// A second pose, far from the first, explains the views about as well.
    pub ambiguous: bool,
    /// The points scatter more than their covariances allow.
    pub high_residual: bool,
}
