//! Pose of 4 to 16 known 3D points from their noisy image points (perspective-n-point), with a true covariance.
//!
//! The solver is deterministic. With so few points every triplet can be tried: each goes through P3P, every candidate
//! pose is scored with the points' 2x2 covariances (MSAC over squared Mahalanobis distances), and the best distinct
//! candidates are refined by robust Levenberg-Marquardt. The inverse Hessian is the pose's covariance. A second
//! candidate that explains the points about as well is reported, not hidden.
//!
//! Equation and frames: `pixel = project(camera_from_points * point)`, see [`crate::geometry`].

mod p3p;
mod problem;
mod quartic;
mod refine;
mod solution;
mod solve;

pub use problem::{MAX_POINTS, MIN_POINTS, PnpError};
pub use solution::{Alternative, Reason, Solution, Status};
pub use solve::{Options, solve};
