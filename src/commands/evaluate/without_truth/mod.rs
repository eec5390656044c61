//! Accuracy on still scenes without ground truth.

mod photos;
mod report;

use std::error::Error;
use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;

use indicatif::ProgressBar;
use nalgebra::Vector3;

use super::super::models::ModelArgs;
use super::options::OutputArgs;
use super::pool::in_parallel;
use crate::estimator::{Estimator, Frame, Selection};
use crate::evaluation::ReadOptions;
use crate::evaluation::agreement::{Bounds, Observation, SceneAgreement, Shape};
use crate::model::{Library, References};
use crate::vision::{DecodeOptions, read_image};
use photos::{Photo, Photos};
use report::{ObjectReport, Report};

/// What to evaluate.
pub(super) struct StillScenes<'a> {
    pub(super) objects: &'a [String],
    pub(super) split: &'a Path,
    pub(super) options: ReadOptions,
    pub(super) models: &'a ModelArgs,
    pub(super) jobs: usize,
    pub(super) keep_going: bool,
    pub(super) output: &'a OutputArgs,
}

impl StillScenes<'_> {
    pub(super) fn run(&self) -> Result<(), Box<dyn Error>> {
        let (library, references) = self.models.library()?;
        let shape = |name: &String| shape(name, &library, &references);
        let shapes = self.objects.iter().map(shape).collect::<Result<Vec<_>, _>>()?;
        let options = ReadOptions { without_truth: true, ..self.options.clone() };
        let Photos { photos, scenes, mut problems } = Photos::of(self.split, &options)?;
        if !self.keep_going {
            problems.none_or_error()?;
        }
        let runtime = self.models.runtime_for(self.jobs)?;
        let selection = Selection { objects: Some(self.objects.to_vec()), ..Selection::ALL };
        let progress = ProgressBar::new(photos.len() as u64).with_message(self.objects.join(", "));
        let results = in_parallel(
            &photos,
            self.jobs,
            !self.keep_going,
            || {
                let estimator = Estimator::new(Arc::clone(&library), Arc::clone(&references), &runtime);
                estimator.map_err(|error| error.to_string())
            },
            |estimator, photo| {
                let found = self.found(estimator, photo, &selection);
                progress.inc(1);
                found.map_err(|error| format!("{}: {error}", photo.image.display()))
            },
        )?;
        progress.finish_and_clear();
        let mut observations = vec![vec![Vec::new(); scenes.len()]; self.objects.len()];
        let mut images = 0;
        for (photo, result) in photos.iter().zip(results) {
            match result {
                Ok(found) => {
                    images += 1;
                    for (object, one) in found {
                        observations[object][photo.scene].push(one);
                    }
                }
                Err(reason) => problems.push(reason),
            }
        }
        if !self.keep_going {
            problems.none_or_error()?;
        }
        let bounds = Bounds::default();
        let mut objects = Vec::new();
        for ((name, shape), by_scene) in self.objects.iter().zip(&shapes).zip(observations) {
            let mut agreements = Vec::new();
            for (scene, found) in scenes.iter().zip(by_scene) {
                match SceneAgreement::of(scene.clone(), shape, &bounds, found) {
                    Ok(agreement) => agreements.push(agreement),
                    Err(error) => problems.push(format!("scene {scene}: {name}: {error}")),
                }
            }
            objects.push(ObjectReport::new(name, shape.diameter_m(), images, agreements));
        }
        if !self.keep_going {
            problems.none_or_error()?;
        }
        let report = Report::new(self.split, bounds, objects, problems.all());
        self.output.write_json(&report)?;
        problems.report();
        std::io::stdout().write_all(report.text().as_bytes())?;
        if report.compares() {
            return Ok(());
        }
        Err("no pose could be compared with another: at least two images must show the object, and their camera poses must be w2c \
             (world to camera)"
            .into())
    }

    /// All poses of the wanted objects in one photo, in the world's frame, with the places of their objects.
    fn found(
        &self,
        estimator: &mut Estimator,
        photo: &Photo,
        selection: &Selection,
    ) -> Result<Vec<(usize, Observation)>, Box<dyn Error>> {
        let image = read_image(&photo.image, &DecodeOptions::default())?;
        let frame = Frame { selection, ..Frame::new(&image, &photo.camera) };
        let estimate = estimator.estimate_all(&[frame]).swap_remove(0)?;
        let mut found = Vec::new();
        for answer in &estimate.poses {
            let object = self.objects.iter().position(|name| *name == answer.object);
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
}

/// What is compared of an object: about the middle of its keypoints.
fn shape(name: &str, library: &Library, references: &References) -> Result<Shape, Box<dyn Error>> {
    let known = || library.known().map(|object| object.manifest.name.as_str()).collect::<Vec<_>>().join(", ");
    let model = library.object(name);
    let model = model
        .ok_or_else(|| format!("object {name:?} has no model, or is no class of the detector; known: {}", known()))?;
    let reference = references.get(name);
    let reference =
        reference.ok_or_else(|| format!("object {name:?} is not calibrated; run `posed calibrate {name}`"))?;
    let keypoints = model.manifest.keypoints();
    let middle = keypoints.iter().sum::<Vector3<f64>>() / keypoints.len() as f64;
    let middle = reference.offset.object_from_keypoints.transform(&middle);
    Ok(Shape::new(model.manifest.diameter_m, middle, model.symmetries.clone())?)
}
