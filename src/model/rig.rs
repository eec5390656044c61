use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use super::manifest::{ManifestError, read_json};
use super::reference::PoseFile;
use posed_core::geometry::{Camera, Covariance6, Pose, is_covariance};

/// Cameras that are fixed to each other: `left-right.rig.json`.
#[derive(Clone, Debug)]
pub struct Rig {
    pub cameras: Vec<RigCamera>,
}

/// One camera of a rig.
#[derive(Clone, Debug)]
pub struct RigCamera {
    pub camera: Camera,
    pub rig_from_camera: Pose,
    /// Covariance of a step of it along the rig's axes, where it is known.
    pub covariance: Option<Covariance6>,
}

/// A rig that cannot be used.
#[derive(Debug, Error)]
pub enum RigError {
    #[error(transparent)]
    File(#[from] ManifestError),
    #[error("{}: a rig has at least two cameras; this one has {given}", path.display())]
    TooFew { path: PathBuf, given: usize },
    #[error("{}: camera {place}: {problem}", path.display())]
    Camera { path: PathBuf, place: usize, problem: String },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    cameras: Vec<RigCameraFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RigCameraFile {
    camera: CameraEntry,
    rig_from_camera: PoseFile,
    #[serde(default)]
    covariance: Option<[[f64; 6]; 6]>,
}

/// The id of a camera file beside the rig's, or a camera.
#[derive(Deserialize)]
#[serde(untagged)]
enum CameraEntry {
    Id(String),
    Given(Box<Camera>),
}

impl Rig {
    /// What the names of files end in.
    pub const SUFFIX: &str = ".rig.json";

    /// Reads a rig; `camera` gives the cameras that it names by an id.
    ///
    /// # Errors
    /// [`RigError`] names the file and the camera.
    pub fn read(path: &Path, camera: impl Fn(&str) -> Option<Camera>) -> Result<Self, RigError> {
        let file: RigFile = read_json(path)?;
        if file.cameras.len() < 2 {
            return Err(RigError::TooFew { path: path.into(), given: file.cameras.len() });
        }
        let read = |(place, entry): (usize, RigCameraFile)| {
            let problem = |problem: String| RigError::Camera { path: path.into(), place, problem };
            let rig_from_camera = Pose::try_from(&entry.rig_from_camera)
                .map_err(|error| problem(format!("field 'rig_from_camera' is not a pose: {error}")))?;
            let camera = match entry.camera {
                CameraEntry::Given(camera) => *camera,
                CameraEntry::Id(id) => {
                    camera(&id).ok_or_else(|| problem(format!("there is no file {id}.camera.json beside it")))?
                }
            };
            let covariance = entry.covariance.map(|rows| Covariance6::from_fn(|row, column| rows[row][column]));
            if covariance.as_ref().is_some_and(|covariance| !is_covariance(covariance)) {
                return Err(problem("field 'covariance' is not symmetric, or has a negative eigenvalue".into()));
            }
            Ok(RigCamera { camera, rig_from_camera, covariance })
        };
        Ok(Self { cameras: file.cameras.into_iter().enumerate().map(read).collect::<Result<_, RigError>>()? })
    }

    /// As [`Rig::read`], with the camera files that lie beside it.
    ///
    /// # Errors
    /// As [`Rig::read`].
    pub fn read_with_cameras_beside(path: &Path) -> Result<Self, RigError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::read(path, |id| read_json(&folder.join(format!("{id}.camera.json"))).ok())
    }
}
