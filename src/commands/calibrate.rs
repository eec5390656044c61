use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::ModelArgs;
use crate::calibration::{Consensus, Mode, Offset, average};
use crate::estimator::solve_object;
use crate::evaluation::{GroundTruth, read_image};
use crate::model::{KeypointModel, Method, PoseFile, Reference, ReferenceView, write_atomically};
use crate::vision::{ImageLimits, decode};

#[derive(Args, Debug)]
#[expect(clippy::doc_markdown, reason = "the comments are the help text")]
pub(super) struct Calibrate {
    /// Name of the object: its folder in the models folder.
    object: String,
    /// BOP scene folder (with scene_gt.json, scene_gt_info.json, scene_camera.json, rgb/) that holds the reference images.
    #[arg(long, value_name = "DIR")]
    scene: PathBuf,
    /// A reference image's number in the scene; several make the offset more exact, best from different sides.
    #[arg(long = "image", value_name = "ID", required = true)]
    images: Vec<u32>,
    /// How several references become one offset.
    #[arg(long, value_enum, default_value_t)]
    mode: ModeArg,
    #[command(flatten)]
    models: ModelArgs,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum ModeArg {
    /// Consensus, then every reference weighted by what its image tells.
    #[default]
    Weighted,
    /// Algorithm 1 of the paper: random hypotheses, then the plain mean.
    Paper,
}

impl From<ModeArg> for Mode {
    fn from(mode: ModeArg) -> Self {
        match mode {
            ModeArg::Weighted => Self::Weighted,
            ModeArg::Paper => Self::Paper,
        }
    }
}

/// A reference with fewer agreeing keypoints would spoil every later answer.
const MIN_INLIERS: usize = 5;

/// What one reference image gives.
struct Measured {
    offset: Offset,
    view: ReferenceView,
    bytes: Vec<u8>,
}

impl Calibrate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let paths = self.models.paths();
        let mut model = KeypointModel::load_uncalibrated(&paths, &self.object, &self.models.runtime()?)?;
        let mut measured = Vec::with_capacity(self.images.len());
        for &image in &self.images {
            measured.push(self.measure(&mut model, image).map_err(|error| format!("image {image}: {error}"))?);
        }
        let mode = Mode::from(self.mode);
        let offsets: Vec<_> = measured.iter().map(|m| m.offset.clone()).collect();
        let averaged = average(&offsets, mode, &Consensus::default())?;
        let mut views = Vec::with_capacity(measured.len());
        println!("{:<16} {:>6} {:>13} {:>14}", "reference", "inlier", "rotation, deg", "translation, mm");
        for (Measured { mut view, bytes, .. }, residual) in measured.into_iter().zip(&averaged.residuals) {
            view.inlier = residual.inlier;
            view.residual_deg = residual.rotation_rad.to_degrees();
            view.residual_mm = 1e3 * residual.translation_m;
            println!("{:<16} {:>6} {:>13.2} {:>14.1}", view.image, view.inlier, view.residual_deg, view.residual_mm);
            // The images first: a reference must never name an image that is not there.
            write_atomically(&paths.reference.join(&view.image), &bytes)?;
            views.push(view);
        }
        let reference = Reference {
            object: self.object.clone(),
            keypoint_model_sha256: model.manifest.model_sha256.clone(),
            method: Method::of(views.len(), mode),
            views,
            offset: averaged.offset,
        };
        let path = paths.reference.join(format!("{}.json", self.object));
        reference.write(&path)?;
        let covariance = reference.offset.covariance;
        println!(
            "{}: offset known to {:.1} mm and {:.2} deg (1 sigma)",
            path.display(),
            1e3 * covariance.fixed_view::<3, 3>(0, 0).trace().sqrt(),
            covariance.fixed_view::<3, 3>(3, 3).trace().sqrt().to_degrees(),
        );
        Ok(())
    }

    fn measure(&self, model: &mut KeypointModel, image: u32) -> Result<Measured, Box<dyn Error>> {
        let (image_path, camera, objects) = read_image(&self.scene, image)?;
        let truth = self.find(&objects, model.manifest.obj_id)?;
        let bytes = fs::read(&image_path)?;
        let pixels = decode(&bytes, &ImageLimits::default())?;
        let camera = camera.with_size(pixels.width(), pixels.height())?;
        let solution = solve_object(model, &pixels, &truth.bounding_box, &camera)??;
        if solution.inlier_count() < MIN_INLIERS {
            return Err(format!(
                "only {} of {} keypoints agree in this image; choose one that shows the object larger and unoccluded",
                solution.inlier_count(),
                solution.residuals().len()
            )
            .into());
        }
        let region = truth.bounding_box;
        let view = ReferenceView {
            image: self.image_name(&image_path, image),
            camera,
            camera_from_object: PoseFile::from(&truth.camera_from_object),
            box_px: [region.x, region.y, region.width, region.height],
            inlier: true,
            residual_deg: 0.0,
            residual_mm: 0.0,
        };
        let offset = Offset::measure(&truth.camera_from_object, &solution.pose, &solution.covariance);
        Ok(Measured { offset, view, bytes })
    }

    /// `<object>.jpg`, or `<object>-<image>.jpg` of several.
    fn image_name(&self, path: &Path, image: u32) -> String {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("jpg");
        let number = if self.images.len() > 1 { format!("-{image}") } else { String::new() };
        format!("{}{number}.{extension}", self.object)
    }

    fn find<'a>(&self, objects: &'a [GroundTruth], obj_id: u32) -> Result<&'a GroundTruth, String> {
        let mut matching = objects.iter().filter(|truth| truth.obj_id == obj_id);
        let object = format!("object {obj_id} ({})", self.object);
        match (matching.next(), matching.next()) {
            (Some(truth), None) if truth.bounding_box.extent() >= 16.0 => Ok(truth),
            (Some(_), None) => Err(format!("{object} is not visible")),
            (Some(_), Some(_)) => Err(format!("{object} is there more than once")),
            (None, _) => Err(format!("{object} is not there")),
        }
    }
}
