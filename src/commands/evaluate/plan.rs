use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::problems::Problems;
use crate::evaluation::{
    DatasetError, GroundTruth, ReadOptions, Scene, SceneFolder, Targets, View, VisibleRange, scenes,
};
use crate::vision::BoundingBox;
use posed_core::geometry::Camera;

/// What is wanted of a dataset.
pub(super) struct Selection<'a> {
    pub(super) obj_ids: &'a [u32],
    pub(super) visible: &'a [VisibleRange],
    pub(super) targets: Option<&'a Targets>,
    /// Whether images matter in which no object counts: a detector may see one there.
    pub(super) empty_images: bool,
    /// Whether the targets are about this split alone.
    pub(super) whole: bool,
}

/// One image to score, without its pixels.
pub(super) struct Task {
    pub(super) scene: String,
    pub(super) scene_id: Option<u32>,
    pub(super) image_id: u32,
    pub(super) image: PathBuf,
    pub(super) camera: Camera,
    /// Those that count first.
    pub(super) instances: Vec<Instance>,
}

impl Task {
    /// Scene and image, as files of results name them.
    pub(super) fn key(&self) -> Option<(u32, u32)> {
        Some((self.scene_id?, self.image_id))
    }
}

/// An object that is in it.
pub(super) struct Instance {
    /// Place among the evaluated objects.
    pub(super) object: usize,
    pub(super) truth: GroundTruth,
    pub(super) region: BoundingBox,
    /// Whether it is scored. Others are there for a detector to find, and neither right nor wrong.
    pub(super) counts: bool,
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
        // A scene of a split, or one split of several, holds a part of the targets.
        let whole = selection.whole && SceneFolder::at(split, options).is_err();
        plan.miss(selection, &there, whole);
        Ok(plan)
    }

    fn add(&mut self, scene: &Scene, selection: &Selection<'_>) {
        let name = scene.path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        for image_id in scene.image_ids() {
            // Only what is asked about may stop the evaluation.
            let wanted = selection.in_image(scene, image_id);
            if wanted.is_empty() && !selection.is_listed(scene, image_id) {
                continue;
            }
            match scene.view(image_id) {
                Ok(view) => {
                    let of_object = |(object, count)| self.instances(&view, selection, object, count);
                    let mut instances: Vec<_> = wanted.into_iter().flat_map(of_object).collect();
                    instances.sort_by_key(|instance| !instance.counts);
                    if selection.empty_images || instances.iter().any(|instance| instance.counts) {
                        let View { image, camera, .. } = view;
                        let scene_id = scene.id;
                        self.tasks.push(Task { scene: name.clone(), scene_id, image_id, image, camera, instances });
                    }
                }
                Err(error) => self.problems.push(error.to_string()),
            }
        }
    }

    /// The instances of one object, those that are seen best first: at most `count` of them count.
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
            let counts = selection.visible.iter().any(|range| range.contains(visible_fraction(truth)));
            instances.push(Instance { object, truth: truth.clone(), region, counts });
        }
        instances.sort_by(|a, b| visible_fraction(&b.truth).total_cmp(&visible_fraction(&a.truth)));
        let beyond = instances.iter_mut().filter(|instance| instance.counts).skip(count);
        beyond.for_each(|instance| instance.counts = false);
        instances
    }

    /// Targets in images that are not there.
    fn miss(&mut self, selection: &Selection<'_>, there: &BTreeSet<(u32, u32)>, whole: bool) {
        let Some(targets) = selection.targets else { return };
        let listed = selection.obj_ids.iter().flat_map(|obj_id| targets.images(*obj_id));
        let scenes: BTreeSet<_> = there.iter().map(|(scene, _)| *scene).collect();
        let here = |(scene, _): &(u32, u32)| whole || scenes.contains(scene);
        let missing: BTreeSet<_> = listed.filter(|place| here(place) && !there.contains(place)).collect();
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
        let counts = self.obj_ids.iter().enumerate().map(|(place, obj_id)| (place, count(*obj_id)));
        // A detector that sees an instance which does not count is not wrong.
        counts
            .filter(|(place, n)| *n > 0 || self.empty_images && scene.may_show(image_id, self.obj_ids[*place]))
            .collect()
    }

    /// Whether an image counts even if no object does.
    fn is_listed(&self, scene: &Scene, image_id: u32) -> bool {
        let listed = |targets: &Targets| scene.id.is_some_and(|scene_id| targets.has_image(scene_id, image_id));
        self.empty_images && self.targets.is_none_or(listed)
    }
}

/// Where a dataset does not say, all of it.
pub(super) fn visible_fraction(truth: &GroundTruth) -> f64 {
    truth.visible_fraction.unwrap_or(1.0)
}
