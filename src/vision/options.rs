use clap::ValueEnum;
use serde::Serialize;

/// What an image may demand before anything is allocated for it, and how it is read.
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

/// What to do with an image that asks to be turned before it is looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum OrientationPolicy {
    /// Refuse it: it is unclear which pixels the camera parameters mean.
    #[default]
    Refuse,
    /// Turn it: the camera parameters belong to the turned image.
    Apply,
    /// Leave it: the camera parameters belong to the pixels as they are stored.
    Ignore,
}
