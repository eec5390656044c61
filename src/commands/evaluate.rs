use std::error::Error;
use std::fs;
use std::path::PathBuf;

use clap::Args;
use image::RgbImage;
use indicatif::ProgressBar;

use super::models::ModelArgs;
use crate::estimator::{Estimator, KeypointSolver, ObjectPose};
use crate::evaluation::{Deviation, GroundTruth, ObjectMesh, Score, image_ids, read_image, scenes};
use crate::model::{ObjectModel, References};
use crate::vision::{BoundingBox, DecodeOptions, Image, decode};
use posed_core::calibration::Offset;
use posed_core::geometry::{Camera, Pose};

/// Intersection over union with the true box from which on a detection is of this object.
const SAME_PLACE_OVERLAP: f64 = 0.5;

#[derive(Args, Debug)]
pub(super) struct Evaluate {
    /// Names of the objects. Each has a folder in the models folder.
    #[arg(required = true)]
    objects: Vec<String>,
    /// BOP split: a folder with scene folders and their ground truth.
    #[arg(long, value_name = "DIR")]
    split: PathBuf,
    /// BOP models folder: meshes and `models_info.json`. Only the scores need it.
    #[arg(long, value_name = "DIR")]
    meshes: PathBuf,
    /// Minimum visible fraction of the object in a view.
    #[arg(long, default_value_t = 0.7)]
    min_visible: f64,
    /// Maximum visible fraction of the object in a view.
    #[arg(long, default_value_t = 1.0)]
    max_visible: f64,
    /// Use the boxes of the detector instead of the ground truth. A view without a pose counts as wrong.
    #[arg(long)]
    detector: bool,
    #[command(flatten)]
    models: ModelArgs,
}

impl Evaluate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let boxes = if self.detector { "The detector's boxes" } else { "Ground-truth boxes" };
        let (split, least, most) = (self.split.display(), self.min_visible, self.max_visible);
        println!("{boxes} of {split}, visible fraction {least} to {most}\n");
        println!(
            "| object | views | ADD(-S) % | Proj-5 % | 5°5cm % | rotation, median (deg) | translation, median (mm) |"
        );
        println!("|---|---|---|---|---|---|---|");
        let runtime = self.models.runtime()?;
        let mut estimator = if self.detector { Some(self.models.estimator(&runtime)?.0) } else { None };
        for name in &self.objects {
            let model = ObjectModel::load(&self.models.models, name)?;
            let mesh = ObjectMesh::read(&self.meshes, model.manifest.obj_id)?;
            let errors = if let Some(estimator) = &mut estimator {
                self.errors(&model, &mesh, |image, camera, truth| detected(estimator, image, camera, name, truth))?
            } else {
                let reference = References::read(&self.models.reference, &model)?;
                let reference = reference
                    .ok_or_else(|| format!("object {name:?} is not calibrated; run `posed calibrate {name}`"))?;
                let mut solver = KeypointSolver::new(&model, &runtime)?;
                self.errors(&model, &mesh, |image, camera, truth| {
                    within_box(&mut solver, &reference.offset, image, camera, &truth.bounding_box)
                })?
            };
            let score = Score::of(&errors, &mesh);
            println!(
                "| {name} | {} | {:.1} | {:.1} | {:.1} | {:.2} | {:.1} |",
                score.views,
                100.0 * score.add,
                100.0 * score.proj5,
                100.0 * score.deg5_cm5,
                score.median_rotation_deg,
                1e3 * score.median_translation_m,
            );
        }
        Ok(())
    }

    /// The error of what `estimate` says of each view that shows enough of the object; `None` where it says nothing.
    fn errors(
        &self,
        model: &ObjectModel,
        mesh: &ObjectMesh,
        mut estimate: impl FnMut(&RgbImage, &Camera, &GroundTruth) -> Result<Option<Pose>, Box<dyn Error>>,
    ) -> Result<Vec<Option<Deviation>>, Box<dyn Error>> {
        let obj_id = model.manifest.obj_id;
        let visible = self.min_visible..=self.max_visible;
        let mut errors = Vec::new();
        let scenes = scenes(&self.split)?;
        let progress = ProgressBar::new(scenes.len() as u64).with_message(model.manifest.name.clone());
        for scene in progress.wrap_iter(scenes.iter()) {
            for image_id in image_ids(scene)? {
                let (path, camera, objects) = read_image(scene, image_id)?;
                for truth in objects.iter().filter(|o| o.obj_id == obj_id && visible.contains(&o.visible_fraction)) {
                    let image = decode(&Image::Encoded(fs::read(&path)?.into()), &DecodeOptions::default())?.image;
                    let error = |pose: Pose| Deviation::new(mesh, &camera, &pose, &truth.camera_from_object);
                    errors.push(estimate(&image, &camera, truth)?.map(error));
                }
            }
        }
        if errors.is_empty() {
            return Err(format!(
                "{}: no view of {} lies within --min-visible and --max-visible",
                self.split.display(),
                model.manifest.name
            )
            .into());
        }
        Ok(errors)
    }
}

/// The pose within a given box.
fn within_box(
    solver: &mut KeypointSolver<'_>,
    offset: &Offset,
    image: &RgbImage,
    camera: &Camera,
    region: &BoundingBox,
) -> Result<Option<Pose>, Box<dyn Error>> {
    let solved = solver.solve(image, region, camera)?;
    Ok(solved.ok().map(|solution| offset.apply(&solution.pose, &solution.covariance).0))
}

/// The most trusted pose that the whole pipeline finds at the place of the true object, whatever its status.
fn detected(
    estimator: &mut Estimator,
    image: &RgbImage,
    camera: &Camera,
    name: &str,
    truth: &GroundTruth,
) -> Result<Option<Pose>, Box<dyn Error>> {
    let there = |found: &ObjectPose| {
        found.object == name && found.detection.bounding_box.overlap(&truth.bounding_box) > SAME_PLACE_OVERLAP
    };
    let poses = estimator.estimate(image, camera)?.poses;
    Ok(poses.into_iter().find(there).and_then(|found| found.pose).map(|pose| pose.camera_from_object))
}
