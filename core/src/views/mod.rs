//! Pose of one rigid object that several calibrated cameras see, in the frame that the cameras' poses are known in.
//!
//! Depth is what one view knows least, and what a second one from the side knows best. All views' points go into one
//! least-squares problem over `world_from_points`:
//!
//! `pixel = project(camera, camera_from_world * step(world_from_points) * point)`, for each view and each of its points.
//!
//! 1. Each view's own poses ([`Mode`], from [`crate::pnp`]) are compared as Gaussians in the world. The one that most views
//!    agree with is where refinement starts; the second of two poses of a flat object finds no company.
//! 2. Levenberg-Marquardt over all whitened reprojections, with a Cauchy loss, then over the inliers alone.
//! 3. A view whose points are elsewhere than the pose puts them takes no part, and the rest are fitted again.
//!
//! What all points of a view share does not average out over them: the error of its camera's pose, and what the network
//! erred in one crop. Each view may therefore see the pose a `step` off, with a covariance of its own. The steps are
//! eliminated from the normal equations in closed form.
//!
//! [`associate`] says beforehand which sightings are of one object, where several of a kind stand about.

mod assignment;
mod associate;
mod consensus;
mod fit;
mod options;
mod prepared;
mod scale;
mod solution;
mod solve;
mod view;

pub use associate::{Sighting, associate};
pub use options::ViewsOptions;
pub use solution::{Doubts, Exclusion, Scale, ViewFit, ViewsSolution};
pub use solve::solve_views;
pub use view::{Mode, Reading, View, ViewsError, isotropic_covariance};
