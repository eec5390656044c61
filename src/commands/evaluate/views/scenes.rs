use std::path::{Path, PathBuf};

use super::super::plan::visible_fraction;
use super::super::problems::Problems;
use crate::evaluation::{DatasetError, ReadOptions, Scene, View, VisibleRange, scenes};
use posed_core::geometry::{Camera, Pose};

/// Two views place one object no farther apart, metres.
const SAME_PLACE_M: f64 = 2e-3;

/// One image of a still scene, without its pixels.
#[derive(Clone)]
pub(super) struct Shot {
    /// Place of its scene.
    scene: usize,
    pub(super) image: PathBuf,
    pub(super) camera: Camera,
    pub(super) world_from_camera: Pose,
    truths: Vec<Truth>,
}

/// An object that is known to be in it.
#[derive(Clone)]
struct Truth {
    obj_id: u32,
    world_from_object: Pose,
    visible: f64,
}

/// All images of a split whose camera poses are known.
pub(super) struct Scenes {
    pub(super) shots: Vec<Shot>,
    pub(super) problems: Problems,
}

/// One object of a scene.
pub(super) struct Instance {
    scene: usize,
    pub(super) world_from_object: Pose,
    /// The images that show enough of it.
    pub(super) views: Vec<usize>,
}

impl Scenes {
    pub(super) fn of(split: &Path, options: &ReadOptions) -> Result<Self, DatasetError> {
        let mut all = Self { shots: Vec::new(), problems: Problems::default() };
        for (place, folder) in scenes(split, options)?.into_iter().enumerate() {
            match folder.read(options) {
                Ok(scene) => all.add(place, &scene),
                Err(error) => all.problems.push(error.to_string()),
            }
        }
        Ok(all)
    }

    fn add(&mut self, place: usize, scene: &Scene) {
        for image_id in scene.image_ids() {
            let shot = |view: View| {
                let View { image, camera, world_from_camera, objects, .. } = view;
                let world_from_camera = world_from_camera?;
                let truth = |annotation: crate::evaluation::Annotation| {
                    let truth = annotation.truth?;
                    let world_from_object = world_from_camera * truth.camera_from_object;
                    Ok(Truth { obj_id: truth.obj_id, world_from_object, visible: visible_fraction(&truth) })
                };
                let truths = objects.into_iter().map(truth).collect::<Result<_, _>>()?;
                Ok(Shot { scene: place, image, camera, world_from_camera, truths })
            };
            match scene.view(image_id).and_then(shot) {
                Ok(shot) => self.shots.push(shot),
                Err(error) => self.problems.push(error.to_string()),
            }
        }
    }
}

impl Instance {
    /// All instances of an object, in the order in which they are met.
    pub(super) fn all_of(shots: &[&Shot], obj_id: u32, visible: &[VisibleRange]) -> Vec<Self> {
        let mut all: Vec<Self> = Vec::new();
        for (index, shot) in shots.iter().enumerate() {
            for truth in shot.truths.iter().filter(|truth| truth.obj_id == obj_id) {
                let same = |one: &&mut Self| {
                    let apart = one.world_from_object.translation() - truth.world_from_object.translation();
                    one.scene == shot.scene && apart.norm() < SAME_PLACE_M
                };
                let counts = visible.iter().any(|range| range.contains(truth.visible));
                let views = if counts { vec![index] } else { Vec::new() };
                if let Some(known) = all.iter_mut().find(same) {
                    known.views.extend(views);
                } else {
                    all.push(Self { scene: shot.scene, world_from_object: truth.world_from_object, views });
                }
            }
        }
        all
    }
}
