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

#![warn(missing_docs)]

mod affine;
mod alignment;
mod camera;
mod epipolar;
mod lie;
mod pose;
mod symmetry;
mod triangulation;
mod whitening;

pub use affine::Affine;
pub use alignment::{AlignmentError, align};
pub use camera::{Camera, CameraError, CameraFile, CameraModel, ProjectionError};
pub use epipolar::{epipolar_error, sampson_distance};
pub use pose::{Covariance6, Pose, PoseError, skew};
pub use symmetry::{BopAxis, BopSymmetries, ContinuousSymmetry, Symmetries, SymmetryError};
pub use triangulation::{Observation, TriangulatedPoint, TriangulationError, triangulate};

pub(crate) use camera::{normalised, normalised_by_point};
pub(crate) use lie::{block_diagonal, covariance_about, join, parts, sigmas};
pub(crate) use whitening::whitening_of;

/// BOP files are in millimetres.
pub(crate) const METRES_PER_MILLIMETRE: f64 = 1e-3;
