//! Accuracy on still scenes without ground truth.

mod report;

use std::error::Error;
use std::path::Path;

use nalgebra::Vector3;

use super::answers::new_estimator;
use super::options::{Asked, OutputArgs};
use super::pool::in_parallel;
use super::shots::{Shot, Shots};
use crate::commands::output::print;
use crate::estimator::{Estimator, Frame, Selection};
use crate::evaluation::ReadOptions;
use crate::evaluation::agreement::{Bounds, Observation, SceneAgreement, Shape};
use crate::model::{Library, References};
use crate::vision::{DecodeOptions, read_image};
use report::{ObjectReport, Report};

/// What to evaluate.
pub(super) struct StillScenes<'a> {
    pub(super) asked: &'a Asked,
    pub(super) split: &'a Path,
    pub(super) output: &'a OutputArgs,
}

impl StillScenes<'_> {
    pub(super) fn run(&self) -> Result<(), Box<dyn Error>> {
        let Asked { objects: names, work, dataset, models, .. } = self.asked;
        let (library, references) = models.library()?;
        let shape = |name: &String| shape(name, &library, &references);
        let shapes = names.iter().map(shape).collect::<Result<Vec<_>, _>>()?;
        let options = ReadOptions { without_truth: true, ..dataset.options()? };
        let Shots { shots, scenes, mut problems } = Shots::of(self.split, &options)?;
        problems.settle(work)?;
        let runtime = models.runtime_for(usize::from(work.jobs))?;
        let selection = Selection { objects: Some(names.clone()), ..Selection::ALL };
        let estimator = || new_estimator(&library, &references, &runtime);
        let results = in_parallel(&shots, work, names.join(", "), estimator, |estimator, photo| {
            let found = found(names, estimator, photo, &selection);
            let found = found.map_err(|error| format!("{}: {error}", photo.image.display()))?;
            Ok((photo.scene, found))
        })?;
        let answered = problems.taken_from(results);
        problems.settle(work)?;
        let images = answered.len();
        let mut observations = vec![vec![Vec::new(); scenes.len()]; names.len()];
        for (scene, found) in answered {
            for (object, one) in found {
                observations[object][scene].push(one);
            }
        }
        let bounds = Bounds::default();
        let mut objects = Vec::new();
        for ((name, shape), by_scene) in names.iter().zip(&shapes).zip(observations) {
            let mut agreements = Vec::new();
            for (scene, found) in scenes.iter().zip(by_scene) {
                match SceneAgreement::of(scene.clone(), shape, &bounds, found) {
                    Ok(agreement) => agreements.push(agreement),
                    Err(error) => problems.push(format!("scene {scene}: {name}: {error}")),
                }
            }
            objects.push(ObjectReport::new(name, shape.diameter_m(), images, agreements));
        }
        problems.settle(work)?;
        let report = Report::new(self.split, bounds, objects, problems.all());
        self.output.write_json(&report)?;
        problems.report();
        print(format_args!("{}", report.text()));
        if report.compares() {
            return Ok(());
        }
        Err("no pose could be compared with another: at least two images must show the object, and their camera poses must be w2c \
             (world to camera)"
            .into())
    }
}

/// All poses of the wanted objects in one photo, in the world's frame, with the places of their objects.
fn found(
    names: &[String],
    estimator: &mut Estimator,
    photo: &Shot,
    selection: &Selection,
) -> Result<Vec<(usize, Observation)>, Box<dyn Error>> {
    let image = read_image(&photo.image, &DecodeOptions::default())?;
    let frame = Frame { selection, ..Frame::new(&image, &photo.camera) };
    let estimate = estimator.estimate_frame(&frame)?;
    let mut found = Vec::new();
    for answer in &estimate.poses {
        let object = names.iter().position(|name| *name == answer.object);
        let Some((object, solved)) = object.zip(answer.pose.as_ref()) else { continue };
        let (world_from_object, covariance) = solved.of_image_in_frame(&photo.world_from_camera);
        let observation = Observation {
            image_id: photo.image_id,
            world_from_object,
            covariance,
            camera_in_world: *photo.world_from_camera.translation(),
            status: answer.verdict.status,
            confidence: answer.confidence(),
        };
        found.push((object, observation));
    }
    Ok(found)
}

/// What is compared of an object: about the middle of its keypoints.
fn shape(name: &str, library: &Library, references: &References) -> Result<Shape, Box<dyn Error>> {
    let known = || library.known().map(|object| object.manifest.name.as_str()).collect::<Vec<_>>().join(", ");
    let model = library.object(name);
    let model = model.ok_or_else(|| format!("object {name:?} has no model; known: {}", known()))?;
    let in_force = references.get(name);
    let in_force =
        in_force.ok_or_else(|| format!("object {name:?} is not calibrated; run `posed calibrate {name}`"))?;
    let offset = &in_force.reference.offset;
    let keypoints = model.manifest.keypoints_scaled_by(offset.keypoints_scale);
    let middle = keypoints.iter().sum::<Vector3<f64>>() / keypoints.len() as f64;
    let middle = offset.object_from_keypoints.transform(&middle);
    Ok(Shape::new(model.manifest.diameter_m, middle, model.symmetries.clone())?)
}
