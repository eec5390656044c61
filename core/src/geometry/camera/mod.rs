//! Cameras with their lenses.

#[cfg(feature = "serde")]
mod file;
mod lens;
mod model;

#[cfg(feature = "serde")]
pub use file::{CameraFile, CameraModel};
pub use model::{Camera, CameraError, ProjectionError};
pub(crate) use model::{normalised, normalised_by_point};
