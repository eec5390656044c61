use serde::{Deserialize, Serialize};

use super::file::Invalid;

/// Order of a network's pixels.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    Nhwc,
    Nchw,
}

/// Type of a network's pixels.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ElementType {
    /// Raw bytes.
    Uint8,
    /// `(byte / 255 - mean) / std`.
    Float32,
    /// The same in 16 bits.
    Float16,
}

/// Order of a pixel's colours.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Channels {
    #[default]
    Rgb,
    Bgr,
}

/// How pixels are handed to a network.
#[derive(Clone, Copy, Debug)]
pub struct PixelFormat {
    pub layout: Layout,
    pub dtype: ElementType,
    pub channels: Channels,
    /// Of pixels in 0..1, in the order of `channels`; `None` subtracts nothing.
    pub mean: Option<[f32; 3]>,
    /// As `mean`; `None` divides by nothing.
    pub std: Option<[f32; 3]>,
}

impl PixelFormat {
    pub(super) fn check(&self) -> Result<(), Invalid> {
        let Self { dtype, mean, std, .. } = self;
        match (dtype, mean, std) {
            (ElementType::Uint8, Some(_), _) => return Err(("input.mean", not_for_bytes())),
            (ElementType::Uint8, None, Some(_)) => return Err(("input.std", not_for_bytes())),
            (ElementType::Uint8, None, None) | (ElementType::Float32 | ElementType::Float16, _, _) => {}
        }
        let unit = "pixels are in 0..1 here: divide values for 0..255 by 255";
        if let Some(mean) = mean.filter(|mean| !mean.iter().all(|m| (-1.0..=1.0).contains(m))) {
            return Err(("input.mean", format!("is {mean:?}; it must be between -1 and 1 ({unit})")));
        }
        if let Some(std) = std.filter(|std| !std.iter().all(|s| (1e-3..=10.0).contains(s))) {
            return Err(("input.std", format!("is {std:?}; it must be between 0.001 and 10 ({unit})")));
        }
        Ok(())
    }
}

fn not_for_bytes() -> String {
    "is for 'dtype': \"float32\" or \"float16\"; raw bytes are not normalised".into()
}
