use std::sync::Arc;

use image::RgbImage;

use super::plan::{Instance, Task};
use crate::estimator::{EstimateError, Estimator, KeypointSolver, ObjectPose};
use crate::evaluation::{Deviation, ModelPoints, ScoredView};
use crate::model::{Library, ObjectModel, References, Runtime};
use crate::vision::{DecodeOptions, read_image};
use posed_core::calibration::Offset;
use posed_core::geometry::{Camera, Pose};

/// Intersection over union with the true box from which on a detection is of this object.
const SAME_PLACE_OVERLAP: f64 = 0.5;

/// An object that is evaluated.
pub(super) struct Object {
    pub(super) model: ObjectModel,
    pub(super) points: ModelPoints,
    /// Of an object whose boxes are given; the pipeline knows its own.
    pub(super) offset: Option<Offset>,
}

/// What all workers share.
pub(super) struct Setup<'a> {
    pub(super) objects: &'a [Object],
    pub(super) runtime: &'a Runtime,
    /// Of the whole pipeline, if that is what is evaluated.
    pub(super) library: Option<(Arc<Library>, Arc<References>)>,
}

/// One worker's networks.
pub(super) struct Scorer<'a> {
    objects: &'a [Object],
    method: Method<'a>,
}

enum Method<'a> {
    Boxes(Vec<KeypointSolver<'a>>),
    Pipeline(Box<Estimator>),
}

/// The place of an object, and what was found of it.
pub(super) type Scored = (usize, ScoredView);

impl<'a> Setup<'a> {
    pub(super) fn scorer(&self) -> Result<Scorer<'a>, String> {
        let method = match &self.library {
            None => {
                let solver = |object: &'a Object| KeypointSolver::new(&object.model, self.runtime);
                self.objects.iter().map(solver).collect::<Result<_, _>>().map(Method::Boxes)
            }
            Some((library, references)) => Estimator::new(Arc::clone(library), Arc::clone(references), self.runtime)
                .map(|estimator| Method::Pipeline(Box::new(estimator))),
        };
        Ok(Scorer { objects: self.objects, method: method.map_err(|error| error.to_string())? })
    }
}

impl Scorer<'_> {
    pub(super) fn score(&mut self, task: &Task) -> Result<Vec<Scored>, String> {
        let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", task.image.display());
        let image = read_image(&task.image, &DecodeOptions::default()).map_err(|error| wrong(&error))?;
        let poses = self.poses(&image, &task.camera, &task.instances).map_err(|error| wrong(&error))?;
        let scored = |(instance, pose): (&Instance, Option<Pose>)| {
            let points = &self.objects[instance.object].points;
            let error = |pose: Pose| Deviation::new(points, &task.camera, &pose, &instance.truth.camera_from_object);
            let (diameter_m, image_width_px) = (points.diameter_m(), image.width());
            (instance.object, ScoredView { deviation: pose.map(error), diameter_m, image_width_px })
        };
        Ok(task.instances.iter().zip(poses).map(scored).collect())
    }

    fn poses(
        &mut self,
        image: &RgbImage,
        camera: &Camera,
        instances: &[Instance],
    ) -> Result<Vec<Option<Pose>>, EstimateError> {
        match &mut self.method {
            Method::Boxes(solvers) => {
                let within_box = |instance: &Instance| {
                    let solved = solvers[instance.object].solve(image, &instance.region, camera)?.ok();
                    let offset = self.objects[instance.object].offset.as_ref();
                    Ok(solved.zip(offset).map(|(found, offset)| offset.apply(&found.pose, &found.covariance).0))
                };
                instances.iter().map(within_box).collect()
            }
            Method::Pipeline(estimator) => {
                let found = estimator.estimate(image, camera)?.poses;
                let at_place = |instance: &Instance| {
                    let name = &self.objects[instance.object].model.manifest.name;
                    most_trusted(&found, name, instance)
                };
                Ok(instances.iter().map(at_place).collect())
            }
        }
    }
}

/// The most trusted pose that the whole pipeline finds at the place of the true object, whatever its status.
fn most_trusted(found: &[ObjectPose], name: &str, instance: &Instance) -> Option<Pose> {
    let there = |pose: &&ObjectPose| {
        pose.object == name && pose.detection.bounding_box.overlap(&instance.region) > SAME_PLACE_OVERLAP
    };
    Some(found.iter().find(there)?.pose.as_ref()?.camera_from_object)
}
