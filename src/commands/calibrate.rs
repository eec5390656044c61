use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args, ValueEnum};
use image::ImageFormat;
use nalgebra::SymmetricEigen;
use serde::Deserialize;

use super::clicks;
use super::dataset::DatasetArgs;
use super::known::{Known, beside};
use super::models::ModelArgs;
use super::output::say;
use crate::estimator::{
    CalibrateOptions, Calibrated, KeypointPrediction, KeypointSolver, KeypointsScale, LocatedView, MeasuredView,
    calibrate, fit_to_measure, no_view_twice,
};
use crate::evaluation::{Scene, SceneFolder};
use crate::model::{ObjectModel, PoseFile, Reference, References, read_json};
use crate::vision::{DecodeOptions, Image, decode, encode, read_image};
use posed_core::calibration::{Mode, Offset};
use posed_core::geometry::{Camera, Pose};
use posed_core::pnp::{self, solve};
use posed_core::views::Scale;

#[derive(Args, Debug)]
#[command(group = ArgGroup::new("source").required(true))]
#[expect(clippy::doc_markdown, reason = "the comments are the help text")]
pub(super) struct Calibrate {
    /// Name of the object. It has a folder in the models folder.
    object: String,
    /// Scene folder with the reference images: BOP (scene_gt.json, scene_gt_info.json, scene_camera.json, rgb/ or gray/) or
    /// LINEMOD (gt.yml, info.yml, rgb/).
    #[arg(long, value_name = "DIR", group = "source", requires = "images")]
    scene: Option<PathBuf>,
    /// Number of a reference image in the scene. Repeat it for a more accurate offset, best with views from other sides.
    #[arg(long = "image", value_name = "ID", requires = "scene")]
    images: Vec<u32>,
    /// Reference images with known poses: a JSON list of {image, camera, camera_from_object, box_px}. Paths are relative
    /// to this file.
    #[arg(long, value_name = "FILE.json", group = "source")]
    references: Option<PathBuf>,
    /// Two images with a known relative pose and points clicked in both: JSON {image, second_image (optional), first_camera,
    /// second_camera, second_from_first, clicks: [{first_px, second_px}], frame: {origin, on_x, in_xy}, box_px}; or a list of such
    /// pairs, best from different sides.
    #[arg(long, value_name = "FILE.json", group = "source")]
    clicks: Option<PathBuf>,
    /// How to average several references.
    #[arg(long, value_enum, default_value_t)]
    mode: ModeChoice,
    /// The origin of the object's frame may lie farther from the object than the object is large.
    #[arg(long)]
    far_origin: bool,
    /// Store the scale of the keypoints that the references show, and not only say it: for a network that sees its object a
    /// percent too large or too small. Needs at least three references from different sides. Without it the scale of the
    /// reference before stays.
    #[arg(long)]
    fit_scale: bool,
    #[command(flatten)]
    dataset: DatasetArgs,
    #[command(flatten)]
    models: ModelArgs,
}

/// [`Mode`] as an option.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum ModeChoice {
    /// Algorithm 1 of the paper as printed: the mean of the references that agree.
    Paper,
    /// The same consensus, with each reference weighted by the information in its view.
    #[default]
    Weighted,
}

impl From<ModeChoice> for Mode {
    fn from(choice: ModeChoice) -> Self {
        match choice {
            ModeChoice::Paper => Self::Paper,
            ModeChoice::Weighted => Self::Weighted,
        }
    }
}

/// One entry of `--references`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReferenceImage {
    image: PathBuf,
    camera: Camera,
    camera_from_object: PoseFile,
    box_px: [f64; 4],
}

/// An axis this many times less exact than the best one deserves a view from the side.
const WEAK_AXIS: f64 = 3.0;
/// A scale this far from that in force helps more often than it spoils: three photos of a real cube that comes out 1 to 2 %
/// too near say it so, and what nothing is wrong with does so once in twenty.
const SIGMAS_TO_ADVISE: f64 = 2.0;
/// Of an object that is seen smaller than this, nothing can be measured.
const MIN_EXTENT_PX: f64 = 16.0;

impl Calibrate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let model = ObjectModel::load(&self.models.models, &self.object)?;
        let known = self.known(&model)?;
        let stated = known.iter().map(|known| (known.path.display().to_string(), known.camera_from_object));
        no_view_twice(&stated.collect::<Vec<_>>())?;
        let mut solver = KeypointSolver::new(&model, &self.models.runtime()?)?;
        let mut measured = Vec::with_capacity(known.len());
        let mut files = Vec::with_capacity(known.len());
        for known in &known {
            let name = known.path.display();
            let (bytes, ending) = encoded(&known.path).map_err(|error| format!("{name}: {error}"))?;
            let file = References::image_name(&self.object, &bytes, &ending);
            let view = measure(&mut solver, known, &bytes, file.clone(), &model);
            measured.push(view.map_err(|error| format!("{name}: {error}"))?);
            files.push((file, bytes));
        }
        // What was fitted of an earlier reference holds for this one, too.
        let before = References::read(&self.models.reference, &model).ok().flatten();
        let stays = before.map_or(1.0, |reference| reference.offset.keypoints_scale);
        let scale = if self.fit_scale { KeypointsScale::Fitted } else { KeypointsScale::Stays(stays) };
        let options = CalibrateOptions { mode: self.mode.into(), far_origin: self.far_origin, scale };
        let Calibrated { reference, scale } = calibrate(&model, measured, options)?;
        References::write(&self.models.reference, &reference, &files)?;
        print(&reference);
        if let Some(scale) = scale {
            say!("{}", self.in_words(scale, stays));
        } else if (stays - 1.0).abs() > 0.0 {
            say!("scale of the keypoints: {stays:.4}, as in the reference before");
        }
        say!("{}", self.models.reference.join(format!("{}.json", self.object)).display());
        Ok(())
    }

    /// What the references show, against what was in force before.
    fn in_words(&self, scale: Scale, in_force: f64) -> String {
        let Scale { value, sigma } = scale;
        let sigmas_off = scale.sigmas_from(in_force);
        let verdict = if self.fit_scale {
            format!("stored; {sigmas_off:.1} sigma from {in_force:.4}, which was in force")
        } else if sigmas_off > SIGMAS_TO_ADVISE {
            let too = if value > in_force { "short" } else { "long" };
            let percent = 1e2 * (in_force / value - 1.0).abs();
            format!(
                "{sigmas_off:.1} sigma from {in_force:.4}, which is in force: distances come out {percent:.1} % too {too}; add \
                 --fit-scale to store it"
            )
        } else {
            format!("{in_force:.4}, which is in force, is within {SIGMAS_TO_ADVISE:.0} sigma")
        };
        format!("scale of the keypoints: {value:.4} (1 sigma {sigma:.4}): {verdict}")
    }

    fn known(&self, model: &ObjectModel) -> Result<Vec<Known>, Box<dyn Error>> {
        if let Some(scene) = &self.scene {
            let options = self.dataset.options()?;
            let scene = SceneFolder::at(scene, &options)?.read(&options)?;
            let of_scene =
                |image: &u32| from_scene(&scene, *image, model).map_err(|e| format!("image {image}: {e}").into());
            self.images.iter().map(of_scene).collect()
        } else if let Some(path) = &self.references {
            let entries: Vec<ReferenceImage> = read_json(path)?;
            entries.iter().map(|entry| entry.known(path)).collect()
        } else if let Some(path) = &self.clicks {
            clicks::known(path, model)
        } else {
            Err("no references; give --scene, --references or --clicks".into())
        }
    }
}

/// A reference image's bytes and what its name ends in. A TIFF becomes a PNG: what reads references knows no TIFF.
fn encoded(path: &Path) -> Result<(Vec<u8>, String), Box<dyn Error>> {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or("jpg").to_lowercase();
    if ["tif", "tiff"].contains(&ending.as_str()) {
        let image = read_image(path, &DecodeOptions::default())?;
        return Ok((encode(&image, ImageFormat::Png)?, "png".into()));
    }
    Ok((fs::read(path)?, ending))
}

fn measure(
    solver: &mut KeypointSolver<'_>,
    known: &Known,
    bytes: &[u8],
    file: String,
    model: &ObjectModel,
) -> Result<MeasuredView, Box<dyn Error>> {
    let image = decode(&Image::Encoded(bytes.to_vec().into()), &DecodeOptions::default())?.image;
    let camera = known.camera.for_image(image.width(), image.height())?;
    fit_to_measure(&image, &camera)?;
    let prediction = solver.locate(&image, &known.region)?;
    let camera = camera.with_size(image.width(), image.height())?;
    let KeypointPrediction { pixels, covariances, .. } = &prediction;
    let solution = solve(&model.manifest.keypoints(), pixels, covariances, &camera, &pnp::Options::default())?;
    let located = LocatedView { camera, camera_from_object: known.camera_from_object, prediction };
    Ok(MeasuredView { file, region: known.region, located, solution })
}

fn print(reference: &Reference) {
    say!("{:<20} {:>6} {:>13} {:>14}", "reference", "inlier", "rotation, deg", "translation, mm");
    for view in &reference.views {
        say!("{:<20} {:>6} {:>13.2} {:>14.1}", view.image, view.inlier, view.residual_deg, view.residual_mm);
    }
    let inliers: Vec<_> = reference.views.iter().filter(|view| view.inlier).collect();
    if inliers.len() > 1 {
        let rms = |squares: f64| (squares / inliers.len() as f64).sqrt();
        say!(
            "spread (RMS of the inliers): {:.2} deg, {:.1} mm",
            rms(inliers.iter().map(|view| view.residual_deg.powi(2)).sum()),
            rms(inliers.iter().map(|view| view.residual_mm.powi(2)).sum()),
        );
    }
    let (translation_m, rotation_rad) = reference.offset.sigmas();
    say!("offset known to {:.1} mm and {:.2} deg (1 sigma)", 1e3 * translation_m, rotation_rad.to_degrees());
    print_weak_axis(&reference.offset);
}

/// A single view knows its own depth least: only a view from the side helps.
fn print_weak_axis(offset: &Offset) {
    let eigen = SymmetricEigen::new(offset.covariance.fixed_view::<3, 3>(0, 0).into_owned());
    let sigmas = eigen.eigenvalues.map(|variance| 1e3 * variance.max(0.0).sqrt());
    let (weakest, best) = (sigmas.imax(), sigmas.min());
    if sigmas[weakest] > WEAK_AXIS * best {
        let axis = eigen.eigenvectors.column(weakest);
        say!(
            "least certain along ({:.2}, {:.2}, {:.2}) of the object's frame: {:.1} mm, {best:.1} mm along the best axis; \
             add a view from the side, across that direction",
            axis[0],
            axis[1],
            axis[2],
            sigmas[weakest]
        );
    }
}

impl ReferenceImage {
    fn known(&self, file: &Path) -> Result<Known, Box<dyn Error>> {
        let name = self.image.display();
        let camera_from_object =
            Pose::try_from(&self.camera_from_object).map_err(|error| format!("{name}: {error}"))?;
        Ok(Known {
            path: beside(file, &self.image),
            camera: self.camera.clone(),
            camera_from_object,
            region: self.box_px.into(),
        })
    }
}

fn from_scene(scene: &Scene, image: u32, model: &ObjectModel) -> Result<Known, Box<dyn Error>> {
    let view = scene.view(image)?;
    let (obj_id, name) = (model.manifest.obj_id, &model.manifest.name);
    let (camera_from_object, region) = match view.truths(obj_id)?[..] {
        [] => return Err(format!("object {obj_id} ({name}) is not in this image; choose another image").into()),
        [truth] => match truth.bounding_box.filter(|region| region.extent() >= MIN_EXTENT_PX) {
            Some(region) => (truth.camera_from_object, region),
            None => return Err(format!("object {obj_id} ({name}) is hardly visible; choose another image").into()),
        },
        _ => return Err(format!("object {obj_id} ({name}) appears more than once; choose another image").into()),
    };
    Ok(Known { path: view.image, camera: view.camera, camera_from_object, region })
}
