use clap::ValueEnum;
use serde::Serialize;

/// Limits of an image, which are checked before memory is allocated, and how it is read.
#[derive(Clone, Copy, Debug)]
pub struct DecodeOptions {
    pub max_side_px: u32,
    pub max_pixels: u64,
    pub exif_orientation: OrientationPolicy,
}

impl Default for DecodeOptions {
    fn default() -> Self {
        Self { max_side_px: 8192, max_pixels: 24_000_000, exif_orientation: OrientationPolicy::default() }
    }
}

/// How to treat an image with an EXIF orientation other than "as stored".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum OrientationPolicy {
    /// Reject the image, because it is unclear which pixels the camera parameters refer to.
    #[default]
    Refuse,
    /// Rotate the image. The camera parameters refer to the rotated image.
    Apply,
    /// Do not rotate the image. The camera parameters refer to the stored pixels.
    Ignore,
}
