//! Whether a network says here what it said where it was trained.

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use serde::Deserialize;
use thiserror::Error;

use super::reading::raw_keypoints;
use crate::model::{Backend, ManifestError, ObjectModel, RuntimeError, read_json};

/// `models/<object>/parity.json`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ParityFile {
    /// For each crop, u and v of each keypoint in crop pixels.
    keypoints_px: Vec<Vec<[f64; 2]>>,
    /// How far the worst one may be off.
    tolerance_px: Option<f64>,
    /// How far they may be off in the median: providers round 8-bit networks differently, each keypoint by its own luck.
    median_tolerance_px: Option<f64>,
}

/// A network that cannot be compared.
#[derive(Debug, Error)]
pub enum ParityError {
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error("{}: {source}", path.display())]
    Crops { path: PathBuf, source: image::ImageError },
    #[error("{}: the image is {width}x{height} pixels; it must have {expected} crops of {size}x{size}, one below the other", path.display())]
    Shape { path: PathBuf, width: u32, height: u32, expected: usize, size: u32 },
    #[error("{}: it must state 'tolerance_px' or 'median_tolerance_px', not both", path.display())]
    Tolerance { path: PathBuf },
    #[error("{}: it has {crops} crops; at most {MAX_CROPS} are allowed", path.display())]
    TooMany { path: PathBuf, crops: usize },
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
}

/// They go through the network together.
const MAX_CROPS: usize = 64;

/// How far a network is from where it was trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parity {
    /// Of the worst keypoint, or in the median.
    pub difference_px: f64,
    pub tolerance_px: f64,
    pub is_median: bool,
}

impl Parity {
    /// Runs an object's network on the crops that the trainer left in its folder; `None` where it left none.
    ///
    /// # Errors
    /// [`ParityError`] names the file.
    pub fn measure(folder: &Path, object: &ObjectModel, backend: &dyn Backend) -> Result<Option<Self>, ParityError> {
        if !folder.join("parity.json").exists() {
            return Ok(None);
        }
        let file: ParityFile = read_json(&folder.join("parity.json"))?;
        let expected = file.keypoints_px.len();
        if expected > MAX_CROPS {
            return Err(ParityError::TooMany { path: folder.join("parity.json"), crops: expected });
        }
        let path = folder.join("parity.png");
        let unreadable = |source| ParityError::Crops { path: path.clone(), source };
        // The size before the pixels, which may be any number.
        let (width, height) = image::image_dimensions(&path).map_err(unreadable)?;
        let size = object.manifest.input.size;
        if width != size || height as usize != expected * size as usize {
            return Err(ParityError::Shape { path, width, height, expected, size });
        }
        let crops = image::open(&path).map_err(unreadable)?.into_rgb8();
        let mut network = object.network(backend)?;
        let found = raw_keypoints(&object.manifest, &mut network, crops.as_raw(), expected)?;
        let pairs = found.iter().zip(&file.keypoints_px).flat_map(|(found, wanted)| found.pixels.iter().zip(wanted));
        let mut differences: Vec<f64> = pairs.map(|(found, wanted)| (found - Vector2::from(*wanted)).norm()).collect();
        differences.sort_by(f64::total_cmp);
        let (quantile, tolerance_px) = match (file.tolerance_px, file.median_tolerance_px) {
            (Some(worst), None) => (differences.last(), worst),
            (None, Some(median)) => (differences.get(differences.len() / 2), median),
            _ => return Err(ParityError::Tolerance { path: folder.join("parity.json") }),
        };
        let difference_px = quantile.copied().unwrap_or(0.0);
        Ok(Some(Self { difference_px, tolerance_px, is_median: file.median_tolerance_px.is_some() }))
    }

    /// Whether the network is the same here.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.difference_px <= self.tolerance_px
    }
}

impl std::fmt::Display for Parity {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { difference_px, tolerance_px, is_median } = self;
        let which = if *is_median { " in the median" } else { "" };
        write!(formatter, "{difference_px:.4} px{which} (limit {tolerance_px})")
    }
}
