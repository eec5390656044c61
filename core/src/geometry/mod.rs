//! Rigid transforms, cameras and image affines. Pure `f64` geometry without I/O.
//!
//! Conventions of the whole crate, stated here once:
//!
//! - A transform is named `a_from_b`: `x_a = a_from_b * x_b`.
//! - Frame `camera` is OpenCV's optical frame (x right, y down, z forward); `object` is the frame the user cares
//!   about; `keypoints` is the frame in which an object's virtual keypoints were drawn.
//! - Metres, radians and seconds. Pixel centres lie at integer coordinates.
//! - 6x6 covariances are row-major in the order x, y, z, rotation about x, y, z, as in ROS
//!   `geometry_msgs/PoseWithCovariance`: translation and a small rotation about the fixed axes of the parent frame.

mod affine;
mod camera;
mod covariance;
mod epipolar;
mod motion_group;
mod pose;
mod rotation;
mod symmetry;
mod triangulation;
mod units;

pub use affine::Affine;
pub use camera::{Camera, CameraError, ProjectionError};
#[cfg(feature = "serde")]
pub use camera::{CameraFile, CameraModel};
pub use covariance::{Covariance6, covariance_about, excess, is_covariance, rotated_covariance, sigmas};
pub use epipolar::{epipolar_error, sampson_distance};
pub use pose::{Pose, PoseError};
pub use rotation::skew;
pub use symmetry::{BopAxis, BopSymmetries, ContinuousSymmetry, Symmetries, SymmetryError};
pub use triangulation::{Observation, TriangulatedPoint, TriangulationError, triangulate};
pub use units::METRES_PER_MILLIMETRE;

pub(crate) use camera::{normalised, normalised_by_point};
pub(crate) use covariance::{block_diagonal, join, parts, whitening_of};
