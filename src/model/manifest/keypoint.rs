use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::file::{Invalid, ManifestError, check_name, read_manifest};
use super::input::{Channels, ElementType, Layout, PixelFormat};
use super::trust::Trust;
use posed_core::geometry::{BopAxis, BopSymmetries, Symmetries, SymmetryError};
use posed_core::pnp::{MAX_POINTS, MIN_POINTS};

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
    /// The keypoints are averaged over these crops: a small network's errors differ from one to the next. One crop by
    /// default.
    #[serde(default = "one_crop")]
    pub crop_ensemble: Vec<CropVariant>,
    /// If given, a first crop is cut around the detection box, and the ensemble's around the keypoints found there. A
    /// network that was trained with such crops need not know the many ways in which detection boxes err, or shrink where
    /// the object is half hidden, nor how the camera was rolled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second_look: Option<SecondLook>,
    pub input: KeypointInput,
    pub output: KeypointOutput,
    /// One factor for each keypoint: the network's covariance times this is the true one on held-out images.
    pub covariance_scale: Vec<f64>,
    /// What its poses can be trusted for. Without it covariances are the solver's own. Confidence is a probability only where
    /// trust states one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trust: Option<Trust>,
    /// Where the network comes from; for people.
    #[serde(default)]
    pub training: serde_json::Value,
}

/// Where the second crops lie among the keypoints of the first.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SecondLook {
    /// Side of the box over the root mean square distance of the keypoints from their centre.
    pub zoom: f64,
    /// A direction of frame `keypoints`, which points up in the crops.
    pub up: [f64; 3],
}

/// A crop beside others of the same place.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CropVariant {
    /// Of `crop_scale`.
    pub scale: f64,
    /// Clockwise rotation of the image in it, degrees.
    #[serde(default)]
    pub turn_deg: f64,
}

impl CropVariant {
    /// The crop as it is.
    pub const PLAIN: Self = Self { scale: 1.0, turn_deg: 0.0 };

    fn is_valid(&self) -> bool {
        (0.5..=2.0).contains(&self.scale) && (-180.0..=180.0).contains(&self.turn_deg)
    }
}

fn one_crop() -> Vec<CropVariant> {
    vec![CropVariant::PLAIN]
}

/// A batch of square crops.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct KeypointInput {
    pub layout: Layout,
    pub dtype: ElementType,
    #[serde(default)]
    pub channels: Channels,
    /// Side of the square crop, pixels.
    pub size: u32,
    /// Mean of each channel, of pixels in 0..1: for floats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of each channel, of pixels in 0..1: for floats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<[f32; 3]>,
}

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum KeypointOutput {
    /// `keypoints [B, N, 2]`, `covariances [B, N, 2, 2]` in crop pixels and `peaks [B, N]` in 0..1. If there are any, also
    /// `second_keypoints [B, N, 2]` with `second_weights [B, N]`: the heatmaps' second peaks and their mass, of the first
    /// ones' mass; and `unfamiliarity [B]`: how little a crop looks like those of training, about 1 for one of them.
    Keypoints,
    /// One output `[B, N, h, w]` of logits, h = w.
    Heatmaps,
}

impl KeypointInput {
    #[must_use]
    pub fn pixels(&self) -> PixelFormat {
        let Self { layout, dtype, channels, mean, std, .. } = *self;
        PixelFormat { layout, dtype, channels, mean, std }
    }
}

impl KeypointManifest {
    /// Reads and checks `object.json`.
    ///
    /// # Errors
    /// [`ManifestError`] names the file and the field.
    pub fn read(path: &Path) -> Result<Self, ManifestError> {
        read_manifest(path, Self::validate)
    }

    #[must_use]
    pub fn keypoints(&self) -> Vec<Vector3<f64>> {
        self.keypoints_scaled_by(1.0)
    }

    /// As large as a reference says that they are.
    #[must_use]
    pub fn keypoints_scaled_by(&self, scale: f64) -> Vec<Vector3<f64>> {
        self.virtual_keypoints_m.iter().map(|point| Vector3::from(*point) * scale).collect()
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

    fn validate(&self) -> Result<(), Invalid> {
        check_name(&self.name).map_err(|problem| ("name", problem))?;
        self.symmetries().map_err(|error| match error {
            SymmetryError::Motion { .. } | SymmetryError::NotFinite => ("symmetries_discrete", error.to_string()),
            SymmetryError::Axis { .. } | SymmetryError::SeveralAxes(_) => ("symmetries_continuous", error.to_string()),
        })?;
        let count = self.virtual_keypoints_m.len();
        if !(MIN_POINTS..=MAX_POINTS).contains(&count) {
            return Err((
                "virtual_keypoints_m",
                format!("has {count} points; it must have {MIN_POINTS} to {MAX_POINTS}"),
            ));
        }
        let extreme = self.virtual_keypoints_m.iter().flatten().any(|v| v.is_nan() || v.abs() >= 10.0);
        if extreme {
            return Err(("virtual_keypoints_m", "has a coordinate beyond 10 m; the unit must be metres".into()));
        }
        if lie_on_a_line(&self.keypoints()) {
            return Err((
                "virtual_keypoints_m",
                "are all in one place or on one line; no pose follows from them".into(),
            ));
        }
        if !(0.005..=5.0).contains(&self.diameter_m) {
            let value = self.diameter_m;
            return Err(("diameter_m", format!("is {value}; it must be between 0.005 and 5, in metres")));
        }
        if !(1.0..=4.0).contains(&self.crop_scale) {
            return Err(("crop_scale", format!("is {}; it must be between 1 and 4", self.crop_scale)));
        }
        let crops = &self.crop_ensemble;
        if !(1..=8).contains(&crops.len()) || !crops.iter().all(CropVariant::is_valid) {
            let problem = "must have 1 to 8 crops with `scale` between 0.5 and 2 and `turn_deg` between -180 and 180";
            return Err(("crop_ensemble", problem.into()));
        }
        if let Some(SecondLook { zoom, up }) = self.second_look {
            if !(1.0..=10.0).contains(&zoom) {
                return Err(("second_look.zoom", format!("is {zoom}; it must be between 1 and 10")));
            }
            if !(0.99..=1.01).contains(&Vector3::from(up).norm()) {
                return Err(("second_look.up", format!("is {up:?}; it must have length 1")));
            }
        }
        if !(16..=1024).contains(&self.input.size) {
            return Err(("input.size", format!("is {}; it must be between 16 and 1024", self.input.size)));
        }
        self.input.pixels().check()?;
        if self.covariance_scale.len() != count {
            let given = self.covariance_scale.len();
            return Err((
                "covariance_scale",
                format!("has {given} factors for {count} keypoints; it must have one for each"),
            ));
        }
        if let Some(scale) = self.covariance_scale.iter().find(|scale| !(1e-6..=1e6).contains(*scale)) {
            return Err(("covariance_scale", format!("has the factor {scale}; each must be between 1e-6 and 1e6")));
        }
        self.trust.as_ref().map_or(Ok(()), Trust::check)
    }
}

/// Whether points span less than a plane, to a ten-thousandth of their extent.
fn lie_on_a_line(points: &[Vector3<f64>]) -> bool {
    let spans = || points.iter().map(|point| point - points[0]);
    let longest = spans().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default();
    let length = longest.norm();
    length < 1e-6 || spans().all(|span| span.cross(&longest).norm() < 1e-4 * length * length)
}
