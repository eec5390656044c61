use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::Matrix4;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::manifest::{MAX_JSON_BYTES, ManifestError, read_bytes};
use posed_core::calibration::{Mode, Offset};
use posed_core::geometry::{Camera, Covariance6, Pose, PoseError};

/// A reference that cannot be used or written.
#[derive(Debug, Error)]
pub enum ReferenceError {
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error("{}: field '{field}' {problem}", path.display())]
    Field { path: PathBuf, field: &'static str, problem: String },
    #[error(
        "{} belongs to another keypoint model (sha256 {stated}; the current one has {found}); make a new reference with \
         `posed calibrate {object}`",
        path.display()
    )]
    OtherModel { path: PathBuf, object: String, stated: String, found: String },
    #[error(
        "{}: the reference is for object {stated:?}, but its file is named after {object:?}; rename the file, or make a \
         reference with `posed calibrate {object}`",
        path.display()
    )]
    OtherObject { path: PathBuf, object: String, stated: String },
    #[error("cannot write {}: {source}; the server needs write access to the folder of references", path.display())]
    Write { path: PathBuf, source: std::io::Error },
}

impl ReferenceError {
    /// Why an object goes without it, for whoever serves it.
    pub(super) fn of_another_net(&self) -> String {
        let Self::OtherModel { object, stated, found, .. } = self else { return self.to_string() };
        format!(
            "its reference belongs to another keypoint net (sha256 {stated}; the current one has {found}); make a new one \
             with `posed calibrate {object}`"
        )
    }
}

/// The calibrated offset of an object: where the user's frame lies in the frame of the virtual keypoints.
#[derive(Clone, Debug)]
pub struct Reference {
    pub object: String,
    pub keypoint_model_sha256: String,
    pub method: Method,
    pub offset: Offset,
    pub views: Vec<ReferenceView>,
}

/// An image that the offset was measured on.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceView {
    /// File name beside the reference.
    pub image: String,
    pub camera: Camera,
    pub camera_from_object: PoseFile,
    /// Box of the object in the image: x, y, width, height in pixels.
    pub box_px: [f64; 4],
    pub inlier: bool,
    pub residual_deg: f64,
    pub residual_mm: f64,
}

/// A pose as JSON: the unit quaternion x, y, z, w and metres. It is read from a 4x4 matrix as well, and from what answers have:
/// both.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(try_from = "PoseEntry")]
pub struct PoseFile {
    pub rotation_xyzw: [f64; 4],
    pub translation_m: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseEntry {
    rotation_xyzw: Option<[f64; 4]>,
    translation_m: Option<[f64; 3]>,
    matrix: Option<[[f64; 4]; 4]>,
}

/// Numbers of answers are rounded by whoever copies them.
const SAME_POSE: f64 = 1e-3;

impl TryFrom<PoseEntry> for PoseFile {
    type Error = String;

    fn try_from(entry: PoseEntry) -> Result<Self, String> {
        let PoseEntry { rotation_xyzw, translation_m, matrix } = entry;
        let of_matrix = |rows: [[f64; 4]; 4]| {
            let pose = Pose::from_matrix(&Matrix4::from_fn(|row, column| rows[row][column]));
            pose.map_err(|error| format!("field 'matrix' is not a pose: {error}"))
        };
        let of_matrix = matrix.map(of_matrix).transpose()?;
        match (rotation_xyzw.zip(translation_m), of_matrix) {
            (Some((rotation_xyzw, translation_m)), None) => Ok(Self { rotation_xyzw, translation_m }),
            (Some((rotation_xyzw, translation_m)), Some(of_matrix)) => {
                let file = Self { rotation_xyzw, translation_m };
                let pose = Pose::try_from(&file).map_err(|error| error.to_string())?;
                let apart = (pose.translation() - of_matrix.translation()).norm();
                if pose.angle_to(&of_matrix) > SAME_POSE || apart > SAME_POSE {
                    return Err(
                        "field 'matrix' is another pose than 'rotation_xyzw' and 'translation_m'; give one of them"
                            .into(),
                    );
                }
                Ok(file)
            }
            (None, Some(pose)) if rotation_xyzw.is_none() && translation_m.is_none() => Ok((&pose).into()),
            (None, _) => {
                Err("a pose needs 'rotation_xyzw' and 'translation_m', or 'matrix' (4x4, row-major, metres)".into())
            }
        }
    }
}

impl From<&Pose> for PoseFile {
    fn from(pose: &Pose) -> Self {
        Self { rotation_xyzw: pose.rotation_xyzw(), translation_m: pose.translation_m() }
    }
}

impl TryFrom<&PoseFile> for Pose {
    type Error = PoseError;

    fn try_from(file: &PoseFile) -> Result<Self, PoseError> {
        Self::from_quaternion_xyzw(file.rotation_xyzw, file.translation_m)
    }
}

/// `reference/<object>.json`.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ReferenceFile {
    object: String,
    keypoint_model_sha256: String,
    method: Method,
    object_from_keypoints: PoseFile,
    covariance: [[f64; 6]; 6],
    #[serde(default = "unscaled", skip_serializing_if = "is_unscaled")]
    keypoints_scale: f64,
    references: Vec<ReferenceView>,
}

/// A network that sees its object larger or smaller by more than that is the wrong one.
pub(crate) const KEYPOINTS_SCALE: std::ops::RangeInclusive<f64> = 0.8..=1.25;

fn unscaled() -> f64 {
    1.0
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    clippy::float_cmp,
    reason = "what serde asks for; exactly 1 is what is not stated"
)]
fn is_unscaled(scale: &f64) -> bool {
    *scale == 1.0
}

/// How the offset follows from the reference images.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// One image.
    Single,
    /// [`Mode::Paper`] over several.
    Paper,
    /// [`Mode::Weighted`] over several.
    Weighted,
}

impl Method {
    /// What averaging this many images in a mode is called.
    #[must_use]
    pub fn of(images: usize, mode: Mode) -> Self {
        match (images, mode) {
            (0 | 1, _) => Self::Single,
            (_, Mode::Paper) => Self::Paper,
            (_, Mode::Weighted) => Self::Weighted,
        }
    }
}

impl Reference {
    /// Reads a reference and checks that it belongs to this object and to the keypoint model with this hash.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file and the field, or says how to recalibrate.
    pub fn read(path: &Path, object: &str, keypoint_model_sha256: &str) -> Result<Self, ReferenceError> {
        Self::parse(path, &read_bytes(path, MAX_JSON_BYTES)?, object, keypoint_model_sha256)
    }

    /// As [`read`](Self::read), of what is in the file.
    pub(super) fn parse(
        path: &Path,
        bytes: &[u8],
        object: &str,
        keypoint_model_sha256: &str,
    ) -> Result<Self, ReferenceError> {
        let unreadable = |source| ManifestError::Json { path: path.into(), source };
        let file: ReferenceFile = serde_json::from_slice(bytes).map_err(unreadable)?;
        if file.object != object {
            return Err(ReferenceError::OtherObject { path: path.into(), object: object.into(), stated: file.object });
        }
        if !file.keypoint_model_sha256.eq_ignore_ascii_case(keypoint_model_sha256) {
            return Err(ReferenceError::OtherModel {
                path: path.into(),
                object: file.object,
                stated: file.keypoint_model_sha256,
                found: keypoint_model_sha256.into(),
            });
        }
        let invalid = |field, problem| ReferenceError::Field { path: path.into(), field, problem };
        let object_from_keypoints = Pose::try_from(&file.object_from_keypoints)
            .map_err(|error| invalid("object_from_keypoints", format!("is not a pose: {error}")))?;
        let covariance = Covariance6::from_fn(|row, column| file.covariance[row][column]);
        let symmetric = (covariance - covariance.transpose()).amax() <= 1e-9 * covariance.amax();
        if !symmetric || covariance.cholesky().is_none() {
            return Err(invalid("covariance", "is not symmetric and positive definite".into()));
        }
        if !KEYPOINTS_SCALE.contains(&file.keypoints_scale) {
            let (scale, least, most) = (file.keypoints_scale, KEYPOINTS_SCALE.start(), KEYPOINTS_SCALE.end());
            return Err(invalid("keypoints_scale", format!("is {scale}; it must be between {least} and {most}")));
        }
        Ok(Self {
            object: file.object,
            keypoint_model_sha256: file.keypoint_model_sha256,
            method: file.method,
            offset: Offset { object_from_keypoints, covariance, keypoints_scale: file.keypoints_scale },
            views: file.references,
        })
    }

    /// Writes the reference so that a reader sees the old file or the new one, never a part.
    ///
    /// # Errors
    /// When the folder cannot be written to.
    pub fn write(&self, path: &Path) -> Result<(), ReferenceError> {
        let file = ReferenceFile {
            object: self.object.clone(),
            keypoint_model_sha256: self.keypoint_model_sha256.clone(),
            method: self.method,
            object_from_keypoints: (&self.offset.object_from_keypoints).into(),
            covariance: self.offset.covariance.transpose().into(),
            keypoints_scale: self.offset.keypoints_scale,
            references: self.views.clone(),
        };
        let mut text =
            serde_json::to_vec_pretty(&file).map_err(|source| ManifestError::Json { path: path.into(), source })?;
        text.push(b'\n');
        write_atomically(path, &text).map_err(|source| ReferenceError::Write { path: path.into(), source })
    }
}

/// Temporary file in the same folder, fsync, rename.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let mut temporary = tempfile::NamedTempFile::new_in(folder)?;
    temporary.write_all(bytes)?;
    temporary.as_file().sync_all()?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // Temporary files are private to their owner; a reference is for every reader of the folder.
        temporary.as_file().set_permissions(fs::Permissions::from_mode(0o644))?;
    }
    temporary.persist(path).map_err(|error| error.error)?;
    Ok(())
}
