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
}

/// How bytes become floats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    pub mean: [f32; 3],
    pub std: [f32; 3],
}

impl Normalisation {
    /// By default nothing is subtracted and nothing divided by.
    pub(super) fn new(mean: Option<[f32; 3]>, std: Option<[f32; 3]>) -> Self {
        Self { mean: mean.unwrap_or([0.0; 3]), std: std.unwrap_or([1.0; 3]) }
    }
}

/// Raw bytes come as rows of pixels, floats as planes: nobody exports anything else.
pub(super) fn check(
    layout: Layout,
    dtype: ElementType,
    mean: Option<[f32; 3]>,
    std: Option<[f32; 3]>,
) -> Result<(), Invalid> {
    match (layout, dtype) {
        (Layout::Nhwc, ElementType::Uint8) => match (mean, std) {
            (None, None) => Ok(()),
            (Some(_), _) | (None, Some(_)) => {
                Err(("input.mean", "and 'std' are for 'dtype': \"float32\"; raw bytes are not normalised".into()))
            }
        },
        (Layout::Nchw, ElementType::Float32) => {
            let Normalisation { mean, std } = Normalisation::new(mean, std);
            if !mean.iter().all(|m| m.is_finite()) {
                return Err(("input.mean", "has a value that is not finite".into()));
            }
            if !std.iter().all(|s| *s > 1e-6 && s.is_finite()) {
                return Err(("input.std", "has a value that is not positive".into()));
            }
            Ok(())
        }
        (Layout::Nhwc, ElementType::Float32) | (Layout::Nchw, ElementType::Uint8) => {
            Err(("input.layout", "and 'dtype' must be nhwc with uint8, or nchw with float32".into()))
        }
    }
}
