use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use super::problems::Problems;
use crate::evaluation::{DatasetError, GroundTruth, ReadOptions, Scene, Targets, View, scenes};
use crate::vision::BoundingBox;
use posed_core::geometry::Camera;

/// What is wanted of a dataset.
pub(super) struct Selection<'a> {
    pub(super) obj_ids: &'a [u32],
    pub(super) visible: RangeInclusive<f64>,
    pub(super) targets: Option<&'a Targets>,
}

/// One image to score, without its pixels.
pub(super) struct Task {
    pub(super) image: PathBuf,
    pub(super) camera: Camera,
    pub(super) instances: Vec<Instance>,
}

/// An object to find in it.
pub(super) struct Instance {
    /// Place among the evaluated objects.
    pub(super) object: usize,
    pub(super) truth: GroundTruth,
    pub(super) region: BoundingBox,
}

/// All images to score. Of a scene, only what is needed of it is kept.
pub(super) struct Plan {
    pub(super) tasks: Vec<Task>,
    pub(super) problems: Problems,
}

impl Plan {
    pub(super) fn of(split: &Path, options: &ReadOptions, selection: &Selection<'_>) -> Result<Self, DatasetError> {
        let mut plan = Self { tasks: Vec::new(), problems: Problems::default() };
        let mut there = BTreeSet::new();
        for folder in scenes(split, options)? {
            match folder.read(options) {
                Ok(scene) => {
                    there.extend(scene.id.into_iter().flat_map(|id| scene.image_ids().map(move |image| (id, image))));
                    plan.add(&scene, selection);
                }
                Err(error) => plan.problems.push(error.to_string()),
            }
        }
        plan.miss(selection, &there);
        Ok(plan)
    }

    fn add(&mut self, scene: &Scene, selection: &Selection<'_>) {
        for image_id in scene.image_ids() {
            // Only what is asked about may stop the evaluation.
            let wanted = selection.in_image(scene, image_id);
            if wanted.is_empty() {
                continue;
            }
            match scene.view(image_id) {
                Ok(view) => {
                    let counts = |(object, count)| self.instances(&view, selection, object, count);
                    let instances: Vec<_> = wanted.into_iter().flat_map(counts).collect();
                    if !instances.is_empty() {
                        self.tasks.push(Task { image: view.image, camera: view.camera, instances });
                    }
                }
                Err(error) => self.problems.push(error.to_string()),
            }
        }
    }

    /// The instances of one object that count, those that are seen best first.
    fn instances(&mut self, view: &View, selection: &Selection<'_>, object: usize, count: usize) -> Vec<Instance> {
        let truths = match view.truths(selection.obj_ids[object]) {
            Ok(truths) => truths,
            Err(error) => {
                self.problems.push(error.to_string());
                return Vec::new();
            }
        };
        let mut instances = Vec::new();
        for truth in truths {
            let Some(region) = truth.bounding_box else {
                self.problems.invisible += 1;
                continue;
            };
            if selection.visible.contains(&visible_fraction(truth)) {
                instances.push(Instance { object, truth: truth.clone(), region });
            }
        }
        instances.sort_by(|a, b| visible_fraction(&b.truth).total_cmp(&visible_fraction(&a.truth)));
        instances.truncate(count);
        instances
    }

    /// Targets in images that are not there.
    fn miss(&mut self, selection: &Selection<'_>, there: &BTreeSet<(u32, u32)>) {
        let Some(targets) = selection.targets else { return };
        let listed = selection.obj_ids.iter().flat_map(|obj_id| targets.images(*obj_id));
        let missing: BTreeSet<_> = listed.filter(|place| !there.contains(place)).collect();
        let mut by_scene = BTreeMap::<u32, Vec<u32>>::new();
        for (scene, image) in missing {
            by_scene.entry(scene).or_default().push(image);
        }
        for (scene, images) in by_scene {
            let all: Vec<_> = images.iter().map(u32::to_string).collect();
            self.problems.push(format!("targets in scene {scene} have no ground truth: image {}", all.join(", ")));
        }
    }
}

impl Selection<'_> {
    /// Places of the objects that count in an image, and how many instances of each.
    fn in_image(&self, scene: &Scene, image_id: u32) -> Vec<(usize, usize)> {
        let count = |obj_id: u32| match (self.targets, scene.id) {
            _ if !scene.may_show(image_id, obj_id) => 0,
            (None, _) => usize::MAX,
            (Some(targets), Some(scene_id)) => targets.instances(scene_id, image_id, obj_id),
            (Some(_), None) => 0,
        };
        self.obj_ids.iter().enumerate().map(|(place, obj_id)| (place, count(*obj_id))).filter(|(_, n)| *n > 0).collect()
    }
}

/// Where a dataset does not say, all of it.
fn visible_fraction(truth: &GroundTruth) -> f64 {
    truth.visible_fraction.unwrap_or(1.0)
}
