use nalgebra::Vector2;

use super::problem::MAX_POINTS;
use crate::geometry::{Covariance6, Pose};

/// How far a pose can be trusted, the most trusted first: of two judgements the greater one holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "snake_case"))]
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

/// What speaks against a pose, as far as the points alone tell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Doubts {
    /// A second pose, far from the first, has a comparable cost.
    pub planar_ambiguity: bool,
    /// The points scatter more about the pose than their covariances allow.
    pub high_residual: bool,
    /// Too few points agree with the pose.
    pub few_inliers: bool,
}

/// How well one point agrees with a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Projection minus observation, pixels. Not finite where the pose projects the point to no pixel.
    pub error_px: Vector2<f64>,
    /// Squared Mahalanobis distance.
    pub squared: f64,
    /// Within the 99.9 % ellipse of its covariance; the pose and its covariance rest on these points alone.
    pub inlier: bool,
    /// The point's pixel lies beyond the domain of the lens model: the point takes no part, as if it had not been seen.
    pub outside_lens: bool,
}

impl Residual {
    pub(super) const OUTSIDE: Self = Self {
        error_px: Vector2::new(f64::INFINITY, f64::INFINITY),
        squared: f64::INFINITY,
        inlier: false,
        outside_lens: true,
    };
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
    /// How far the points alone let the pose be trusted.
    pub status: Status,
    /// Why not further.
    pub doubts: Doubts,
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

    /// Root mean square reprojection error of the inliers, pixels. Finite: an inlier at the end of the lens model's domain may
    /// be projected to no pixel, and is not counted.
    #[must_use]
    pub fn rmse_px(&self) -> f64 {
        let squares = self.residuals().iter().filter(|r| r.inlier).map(|r| r.error_px.norm_squared());
        let (sum, count) = squares
            .filter(|square| square.is_finite())
            .fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
        (sum / f64::max(count, 1.0)).sqrt()
    }
}
