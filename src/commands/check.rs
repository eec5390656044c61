use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Deserialize;

use super::models::ModelArgs;
use super::output::say;
use crate::estimator::{Estimator, Parity};
use crate::model::{Backend, ObjectModel, PoseFile, read_json};
use crate::vision::{DecodeOptions, Image, decode};
use posed_core::geometry::{Camera, Pose};

#[derive(Args, Debug)]
pub(super) struct Check {
    /// Folder with images, their known poses (`poses.json`) and one `*.camera.json`.
    #[arg(long, default_value = "samples")]
    samples: PathBuf,
    #[command(flatten)]
    models: ModelArgs,
}

/// An object that is known to be in a sample.
#[derive(Deserialize)]
struct KnownPose {
    object: String,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
}

/// A pose is right when it moves the object's keypoints by less than this share of the object's diameter.
const MAX_ERROR: f64 = 0.1;

impl Check {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let runtime = self.models.runtime()?;
        let (mut estimator, catalogue) = self.models.estimator(&runtime)?;
        let library = &catalogue.library;
        estimator.warm_up()?;
        say!("provider {}\n", runtime.provider());
        say!("{:<12} {:<64} difference to the trainer", "model", "sha256");
        for looking in &library.detectors {
            let name =
                looking.owner.as_ref().map_or_else(|| "detector".to_owned(), |owner| format!("{owner}/detector"));
            say!("{name:<12} {}", looking.model.manifest.model_sha256);
        }
        let mut differs = Vec::new();
        for object in library.known() {
            let manifest = &object.manifest;
            let parity = Parity::measure(&self.models.models.join(&manifest.name), object, &runtime)?;
            let text = parity.map_or("unknown".into(), |parity| parity.to_string());
            say!("{:<12} {} {text}", manifest.name, manifest.model_sha256);
            differs.extend(parity.filter(|parity| !parity.holds()).map(|_| manifest.name.as_str()));
        }
        let camera = the_only_camera(&self.samples)?;
        let samples: BTreeMap<String, Vec<KnownPose>> = read_json(&self.samples.join("poses.json"))?;
        say!("\n{:<16} {:<12} {:<15} {:>9} {:>9} {:>8}", "sample", "object", "status", "deg", "mm", "% diam.");
        let (mut poses, mut wrong) = (0, 0);
        for (file, known) in &samples {
            let bytes = fs::read(self.samples.join(file)).map_err(|error| format!("{file}: {error}"))?;
            let decoded = decode(&Image::Encoded(bytes.into()), &DecodeOptions::default());
            let image = decoded.map_err(|error| format!("{file}: {error}"))?.image;
            let found = find(&mut estimator, &image, &camera)?;
            for known in known {
                let object = library.object(&known.object);
                let object = object.ok_or_else(|| format!("{file}: object {:?} has no model", known.object))?;
                poses += 1;
                wrong += usize::from(!report(file, object, known, &found)?);
            }
        }
        say!("\n{} of {poses} poses are right", poses - wrong);
        if wrong > 0 {
            return Err(format!("{wrong} of {poses} poses are missing or wrong").into());
        }
        if !differs.is_empty() {
            return Err(format!(
                "networks with other outputs than in the trainer: {}; export them again, or check ONNX Runtime",
                differs.join(", ")
            )
            .into());
        }
        Ok(())
    }
}

/// Names, statuses and poses of what is in an image.
type Found = Vec<(String, String, Option<Pose>)>;

fn find(estimator: &mut Estimator, image: &image::RgbImage, camera: &Camera) -> Result<Found, Box<dyn Error>> {
    let poses = estimator.estimate(image, camera)?.poses.into_iter();
    let pose = |found: crate::estimator::ObjectPose| {
        (found.object, found.verdict.status.to_string(), found.pose.map(|solved| solved.camera_from_object))
    };
    Ok(poses.map(pose).collect())
}

/// Prints one line; whether the most trusted pose of the object is right.
fn report(file: &str, object: &ObjectModel, known: &KnownPose, found: &Found) -> Result<bool, Box<dyn Error>> {
    let truth = Pose::try_from(&PoseFile { rotation_xyzw: known.rotation_xyzw, translation_m: known.translation_m })
        .map_err(|error| format!("{file}: {error}"))?;
    let name = &known.object;
    let Some((status, pose)) =
        found.iter().find_map(|(object, status, pose)| (object == name).then_some((status, (*pose)?)))
    else {
        say!("{file:<16} {name:<12} not found");
        return Ok(false);
    };
    // Of the poses under which the object looks the same, the one nearest to the truth.
    let pose = object.symmetries.nearest(&pose, &truth);
    let keypoints = object.manifest.keypoints();
    let moved = keypoints.iter().map(|point| (pose.transform(point) - truth.transform(point)).norm());
    let error = moved.sum::<f64>() / keypoints.len() as f64 / object.manifest.diameter_m;
    say!(
        "{file:<16} {name:<12} {status:<15} {:>9.2} {:>9.1} {:>8.1}",
        pose.angle_to(&truth).to_degrees(),
        1e3 * (pose.translation() - truth.translation()).norm(),
        100.0 * error,
    );
    Ok(error < MAX_ERROR)
}

fn the_only_camera(folder: &Path) -> Result<Camera, Box<dyn Error>> {
    let entries = fs::read_dir(folder).map_err(|error| format!("cannot read {}: {error}", folder.display()))?;
    let paths = entries.collect::<Result<Vec<_>, _>>()?.into_iter().map(|entry| entry.path());
    let cameras: Vec<PathBuf> = paths.filter(|path| path.to_string_lossy().ends_with(".camera.json")).collect();
    match &cameras[..] {
        [camera] => Ok(read_json(camera)?),
        others => Err(format!("{}: {} files *.camera.json; keep exactly one", folder.display(), others.len()).into()),
    }
}
