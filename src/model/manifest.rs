use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::geometry::{BopAxis, BopSymmetries, Symmetries, SymmetryError};
use crate::pnp::{MAX_POINTS, MIN_POINTS};

/// A model folder that cannot be used. Every message names the file, and the field where there is one.
#[derive(Debug, Error)]
pub enum ManifestError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    #[error("{}: field '{field}' {problem}", path.display())]
    Field { path: PathBuf, field: &'static str, problem: String },
    #[error(
        "{} has sha256 {found} but its manifest states {stated}: the file is damaged or belongs to another manifest",
        path.display()
    )]
    Hash { path: PathBuf, stated: String, found: String },
}

/// `models/<object>/object.json`.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct KeypointManifest {
    pub name: String,
    /// The object's number in BOP files.
    pub obj_id: u32,
    /// SHA-256 of `keypoints.onnx`, hexadecimal.
    pub model_sha256: String,
    /// Virtual keypoints in the frame `keypoints`, metres.
    pub virtual_keypoints_m: Vec<[f64; 3]>,
    /// The object's largest extent, metres: measured, or estimated from boxes and distances.
    pub diameter_m: f64,
    /// Motions of frame `object` under which the object looks the same, in BOP's syntax: 4x4, row-major, millimetres.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub symmetries_discrete: Vec<[f64; 16]>,
    /// At most one axis of revolution, in BOP's syntax: millimetres.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub symmetries_continuous: Vec<BopAxis>,
    /// Side of the square crop over the larger side of the detection box.
    pub crop_scale: f64,
    /// The keypoints are averaged over crops of these sizes, as factors of `crop_scale`: a small network's errors differ
    /// from one crop to the next. One crop by default.
    #[serde(default = "one_crop")]
    pub crop_ensemble: Vec<f64>,
    pub input: KeypointInput,
    pub output: KeypointOutput,
    /// One factor for each keypoint: the network's covariance times this is the true one on held-out images.
    pub covariance_scale: Vec<f64>,
    /// Where the network comes from; for people.
    #[serde(default)]
    pub training: serde_json::Value,
}

fn one_crop() -> Vec<f64> {
    vec![1.0]
}

/// RGB crops `[B, size, size, 3]`, raw 8-bit.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct KeypointInput {
    pub layout: Layout,
    pub dtype: ElementType,
    /// Side of the square crop, pixels.
    pub size: u32,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    Nhwc,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ElementType {
    Uint8,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum KeypointOutput {
    /// `keypoints [B, N, 2]`, `covariances [B, N, 2, 2]` in crop pixels and `peaks [B, N]` in 0..1.
    Keypoints,
}

/// `models/detector/detector.json`.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorManifest {
    pub format: DetectorFormat,
    /// SHA-256 of `detector.onnx`, hexadecimal.
    pub model_sha256: String,
    pub input: DetectorInput,
    /// Object name of each class, by class index.
    pub labels: Vec<String>,
    /// Detections below this score are dropped.
    pub score_threshold: f64,
    /// Where the network comes from; for people.
    #[serde(default)]
    pub training: serde_json::Value,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DetectorFormat {
    /// Non-maximum suppression inside: `[1, N, 6]` rows of x1, y1, x2, y2 (edges, input pixels), score, class.
    End2end,
}

/// One RGB image `[1, height, width, 3]`, raw 8-bit, letterboxed: fitted at the top left, the rest filled.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorInput {
    pub layout: Layout,
    pub dtype: ElementType,
    pub width: u32,
    pub height: u32,
    /// Grey value of the filling.
    pub fill: u8,
}

impl KeypointManifest {
    /// Reads and checks `object.json`.
    ///
    /// # Errors
    /// [`ManifestError`] names the file and the field.
    pub fn read(path: &Path) -> Result<Self, ManifestError> {
        let manifest: Self = read_json(path)?;
        manifest.validate().map_err(|(field, problem)| ManifestError::Field { path: path.into(), field, problem })?;
        Ok(manifest)
    }

    #[must_use]
    pub fn keypoints(&self) -> Vec<Vector3<f64>> {
        self.virtual_keypoints_m.iter().copied().map(Vector3::from).collect()
    }

    /// What `symmetries_discrete` and `symmetries_continuous` mean.
    ///
    /// # Errors
    /// When they cannot be those of an object.
    pub fn symmetries(&self) -> Result<Symmetries, SymmetryError> {
        Symmetries::try_from(&BopSymmetries {
            symmetries_discrete: self.symmetries_discrete.clone(),
            symmetries_continuous: self.symmetries_continuous.clone(),
        })
    }

    fn validate(&self) -> Result<(), (&'static str, String)> {
        check_name(&self.name).map_err(|problem| ("name", problem))?;
        self.symmetries().map_err(|error| match error {
            SymmetryError::Motion { .. } | SymmetryError::NotFinite => ("symmetries_discrete", error.to_string()),
            SymmetryError::Axis { .. } | SymmetryError::SeveralAxes(_) => ("symmetries_continuous", error.to_string()),
        })?;
        let count = self.virtual_keypoints_m.len();
        if !(MIN_POINTS..=MAX_POINTS).contains(&count) {
            return Err((
                "virtual_keypoints_m",
                format!("has {count} points; {MIN_POINTS} to {MAX_POINTS} are needed"),
            ));
        }
        let extreme = self.virtual_keypoints_m.iter().flatten().any(|v| v.is_nan() || v.abs() >= 10.0);
        if extreme {
            return Err(("virtual_keypoints_m", "has a coordinate beyond 10 m; are these millimetres?".into()));
        }
        if !(0.005..=5.0).contains(&self.diameter_m) {
            let value = self.diameter_m;
            return Err(("diameter_m", format!("is {value}; between 0.005 and 5 m are supported (millimetres?)")));
        }
        if !(1.0..=4.0).contains(&self.crop_scale) {
            return Err(("crop_scale", format!("is {}; it must lie between 1 and 4", self.crop_scale)));
        }
        let factors = &self.crop_ensemble;
        if !(1..=8).contains(&factors.len()) || !factors.iter().all(|factor| (0.5..=2.0).contains(factor)) {
            return Err(("crop_ensemble", format!("is {factors:?}; give 1 to 8 factors between 0.5 and 2")));
        }
        if !(16..=1024).contains(&self.input.size) {
            return Err(("input.size", format!("is {}; it must lie between 16 and 1024", self.input.size)));
        }
        if self.covariance_scale.len() != count {
            let given = self.covariance_scale.len();
            return Err(("covariance_scale", format!("has {given} factors for {count} keypoints")));
        }
        if !self.covariance_scale.iter().all(|s| *s > 0.0 && *s < 1e6) {
            return Err(("covariance_scale", "has a factor that is not a positive number".into()));
        }
        Ok(())
    }
}

impl DetectorManifest {
    /// Reads and checks `detector.json`.
    ///
    /// # Errors
    /// [`ManifestError`] names the file and the field.
    pub fn read(path: &Path) -> Result<Self, ManifestError> {
        let manifest: Self = read_json(path)?;
        manifest.validate().map_err(|(field, problem)| ManifestError::Field { path: path.into(), field, problem })?;
        Ok(manifest)
    }

    fn validate(&self) -> Result<(), (&'static str, String)> {
        if self.labels.is_empty() {
            return Err(("labels", "is empty; name the object of each class".into()));
        }
        for label in &self.labels {
            check_name(label).map_err(|problem| ("labels", problem))?;
        }
        if !(0.0..1.0).contains(&self.score_threshold) {
            return Err(("score_threshold", format!("is {}; it must lie between 0 and 1", self.score_threshold)));
        }
        for (field, side) in [("input.width", self.input.width), ("input.height", self.input.height)] {
            if !(32..=2048).contains(&side) {
                return Err((field, format!("is {side}; it must lie between 32 and 2048")));
            }
        }
        Ok(())
    }
}

/// Reads a model file and checks it against the hash that its manifest states.
pub(super) fn read_model(path: &Path, stated: &str) -> Result<Vec<u8>, ManifestError> {
    let bytes = fs::read(path).map_err(|source| ManifestError::Read { path: path.into(), source })?;
    let found = hex(&Sha256::digest(&bytes));
    if !found.eq_ignore_ascii_case(stated) {
        return Err(ManifestError::Hash { path: path.into(), stated: stated.into(), found });
    }
    Ok(bytes)
}

/// Object names become file names and URL parts.
pub(super) fn check_name(name: &str) -> Result<(), String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if (1..=64).contains(&name.len()) && name.chars().all(allowed) {
        Ok(())
    } else {
        Err(format!("contains {name:?}; names have 1 to 64 letters, digits, '_' or '-'"))
    }
}

pub(crate) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ManifestError> {
    let text = fs::read(path).map_err(|source| ManifestError::Read { path: path.into(), source })?;
    serde_json::from_slice(&text).map_err(|source| ManifestError::Json { path: path.into(), source })
}

fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
