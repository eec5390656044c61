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
    tolerance_px: f64,
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
    pub worst_px: f64,
    pub tolerance_px: f64,
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
        let worst_px = pairs.map(|(found, wanted)| (found - Vector2::from(*wanted)).amax()).fold(0.0, f64::max);
        Ok(Some(Self { worst_px, tolerance_px: file.tolerance_px }))
    }

    /// Whether the network is the same here.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.worst_px <= self.tolerance_px
    }
}
