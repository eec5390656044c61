//! `object.json` and `detector.json`: what a network takes and returns, and what its numbers mean.

mod detector;
mod file;
mod input;
mod keypoint;
mod trust;

pub use detector::{Coordinates, DetectorFormat, DetectorInput, DetectorManifest, Placement};
pub use file::ManifestError;
pub(super) use file::{MAX_JSON_BYTES, MAX_MODEL_BYTES, check_name, hex, read_bytes, read_model, sha256_hex};
pub(crate) use file::{read_json, read_regular};
pub use input::{Channels, ElementType, Layout, PixelFormat};
pub use keypoint::{CropVariant, KeypointInput, KeypointManifest, KeypointOutput, SecondLook};
pub use trust::{CovarianceTrust, Linear, Trust};
