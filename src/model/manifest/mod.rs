//! `object.json` and `detector.json`: what a network takes and returns, and what its numbers mean.

mod detector;
mod file;
mod input;
mod keypoint;

pub use detector::{Coordinates, DetectorFormat, DetectorInput, DetectorManifest, Placement};
pub use file::ManifestError;
pub(crate) use file::read_json;
pub(super) use file::read_model;
pub use input::{Channels, ElementType, Layout, PixelFormat};
pub use keypoint::{CropVariant, KeypointInput, KeypointManifest, KeypointOutput, SecondLook};
