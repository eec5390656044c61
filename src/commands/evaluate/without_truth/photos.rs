use std::path::{Path, PathBuf};

use super::super::problems::Problems;
use crate::evaluation::{DatasetError, ReadOptions, Scene, View, scenes};
use posed_core::geometry::{Camera, Pose};

/// One image of a still scene, without its pixels.
pub(super) struct Photo {
    /// Place of its scene.
    pub(super) scene: usize,
    pub(super) image_id: u32,
    pub(super) image: PathBuf,
    pub(super) camera: Camera,
    pub(super) world_from_camera: Pose,
}

/// All images of a split whose camera poses are known.
pub(super) struct Photos {
    pub(super) photos: Vec<Photo>,
    /// Names of the scenes.
    pub(super) scenes: Vec<String>,
    pub(super) problems: Problems,
}

impl Photos {
    pub(super) fn of(split: &Path, options: &ReadOptions) -> Result<Self, DatasetError> {
        let mut all = Self { photos: Vec::new(), scenes: Vec::new(), problems: Problems::default() };
        for folder in scenes(split, options)? {
            match folder.read(options) {
                Ok(scene) => all.add(&scene),
                Err(error) => all.problems.push(error.to_string()),
            }
        }
        Ok(all)
    }

    fn add(&mut self, scene: &Scene) {
        let place = self.scenes.len();
        let name = scene.path.file_name().unwrap_or(scene.path.as_os_str());
        self.scenes.push(name.to_string_lossy().into_owned());
        for image_id in scene.image_ids() {
            let photo = |view: View| {
                let View { image, camera, world_from_camera, .. } = view;
                Ok(Photo { scene: place, image_id, image, camera, world_from_camera: world_from_camera? })
            };
            match scene.view(image_id).and_then(photo) {
                Ok(photo) => self.photos.push(photo),
                Err(error) => self.problems.push(error.to_string()),
            }
        }
    }
}
