//! The images of a split whose camera poses are known.

use std::path::{Path, PathBuf};

use super::plan::visible_fraction;
use super::problems::Problems;
use crate::evaluation::{Annotation, DatasetError, ReadOptions, Scene, View, scenes};
use posed_core::geometry::{Camera, Pose};

/// One image of a still scene, without its pixels.
#[derive(Clone)]
pub(super) struct Shot {
    /// Place of its scene.
    pub(super) scene: usize,
    pub(super) image_id: u32,
    pub(super) image: PathBuf,
    pub(super) camera: Camera,
    pub(super) world_from_camera: Pose,
    /// None where the split is read without its truth.
    pub(super) truths: Vec<ShotTruth>,
}

/// An object that is known to be in it.
#[derive(Clone)]
pub(super) struct ShotTruth {
    pub(super) obj_id: u32,
    pub(super) world_from_object: Pose,
    pub(super) visible: f64,
}

/// All of them.
pub(super) struct Shots {
    pub(super) shots: Vec<Shot>,
    /// Names of the scenes.
    pub(super) scenes: Vec<String>,
    pub(super) problems: Problems,
}

impl Shots {
    pub(super) fn of(split: &Path, options: &ReadOptions) -> Result<Self, DatasetError> {
        let mut all = Self { shots: Vec::new(), scenes: Vec::new(), problems: Problems::default() };
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
            let shot = |view: View| {
                let View { image, camera, world_from_camera, objects, .. } = view;
                let world_from_camera = world_from_camera?;
                let truth = |annotation: Annotation| {
                    let truth = annotation.truth?;
                    let world_from_object = world_from_camera * truth.camera_from_object;
                    Ok(ShotTruth { obj_id: truth.obj_id, world_from_object, visible: visible_fraction(&truth) })
                };
                let truths = objects.into_iter().map(truth).collect::<Result<_, _>>()?;
                Ok(Shot { scene: place, image_id, image, camera, world_from_camera, truths })
            };
            match scene.view(image_id).and_then(shot) {
                Ok(shot) => self.shots.push(shot),
                Err(error) => self.problems.push(error.to_string()),
            }
        }
    }
}
