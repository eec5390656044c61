use std::path::{Path, PathBuf};

use super::error::DatasetError;
use super::scene::Scene;
use super::{bop, linemod};
use posed_core::geometry::Camera;

/// What a dataset does not say itself.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Of a dataset with several sensors, whose ground truth to read: `primesense` for `scene_gt_primesense.json`.
    pub sensor: String,
    /// The camera of images whose dataset states none.
    pub camera: Option<Camera>,
    /// Read no ground truth, whether it is there or not: only images and cameras, of scenes of the BOP format.
    pub without_truth: bool,
}

/// A folder that holds a scene. Reading it parses its files once, for all images.
#[derive(Clone, Debug)]
pub struct SceneFolder {
    path: PathBuf,
    layout: Layout,
}

#[derive(Clone, Copy, Debug)]
enum Layout {
    Bop,
    BopCameras,
    Linemod,
}

impl SceneFolder {
    /// A folder that holds a scene itself.
    ///
    /// # Errors
    /// When it has the files of none of the layouts.
    pub fn at(path: &Path, options: &ReadOptions) -> Result<Self, DatasetError> {
        let suffix = || if options.sensor.is_empty() { String::new() } else { format!("_{}", options.sensor) };
        let layout = if options.without_truth {
            if !bop::cameras_file(path, &options.sensor).is_file() {
                return Err(DatasetError::NoCameras { path: path.into(), suffix: suffix() });
            }
            Layout::BopCameras
        } else if bop::poses_file(path, &options.sensor).is_file() {
            Layout::Bop
        } else if linemod::poses_file(path).is_file() {
            Layout::Linemod
        } else {
            return Err(DatasetError::NoScene { path: path.into(), suffix: suffix() });
        };
        Ok(Self { path: path.into(), layout })
    }

    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// # Errors
    /// [`DatasetError`] names the file that cannot be read. What is wrong with single images, they say themselves.
    pub fn read(&self, options: &ReadOptions) -> Result<Scene, DatasetError> {
        match self.layout {
            Layout::Bop => bop::read(&self.path, &options.sensor),
            Layout::BopCameras => bop::read_cameras(&self.path, &options.sensor),
            Layout::Linemod => linemod::read(&self.path, options.camera.as_ref()),
        }
    }
}

/// The scenes of a folder, in order; or the folder itself if it is one.
///
/// # Errors
/// When the folder cannot be read, or holds no scene.
pub fn scenes(folder: &Path, options: &ReadOptions) -> Result<Vec<SceneFolder>, DatasetError> {
    let itself = SceneFolder::at(folder, options);
    if let Ok(scene) = itself {
        return Ok(vec![scene]);
    }
    let unreadable = |source| DatasetError::Read { path: folder.into(), source };
    let mut scenes = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        scenes.extend(SceneFolder::at(&entry.map_err(unreadable)?.path(), options));
    }
    scenes.sort_by(|a, b| a.path.cmp(&b.path));
    if scenes.is_empty() { itself.map(|scene| vec![scene]) } else { Ok(scenes) }
}
