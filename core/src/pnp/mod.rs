//! Pose of 4 to 16 known 3D points from their noisy image points (perspective-n-point), with a true covariance.
//!
//! The solver is deterministic: no random sampling.
//!
//! 1. Pixels are undistorted, and whitened by their 2x2 covariances.
//! 2. Triplets of points go through P3P (Ding et al., CVPR 2023), the widest and best known triangles first. Every pose
//!    found is scored over all points (MSAC over squared Mahalanobis distances). Where the first triplets already give
//!    a pose that settles the matter, that is all; else every triplet is tried, so that a few outliers never spoil all.
//! 3. The best distinct candidates, the mirror image that a flat object has, and the previous pose of a track are
//!    refined by Levenberg-Marquardt with a Cauchy loss, then by least squares over the inliers alone, whose inverse
//!    Hessian is the pose's covariance.
//! 4. A second mode that explains the points about as well is reported, not hidden.
//!
//! Equation and frames: `pixel = project(camera_from_points * point)`, see [`crate::geometry`]. SQPnP (Terzakis and
//! Lourakis, ECCV 2020) and EPnP are no seeds here: no problem of `benches/compare/pnp.py` needs one.

mod cubic;
mod hypotheses;
mod modes;
mod p3p;
mod problem;
mod refine;
mod solution;
mod solve;

pub use problem::{MAX_POINTS, MIN_POINTS, PnpError};
pub use solution::{Alternative, Doubts, Residual, Solution, Status};
pub use solve::{Options, solve};

pub(crate) use problem::Problem;
pub(crate) use refine::{Loss, Refined};
pub(crate) use solve::{INLIER, ROBUST, improbable};
