use std::error::Error;
use std::fs;
use std::path::PathBuf;

use clap::Args;

use super::ModelArgs;
use crate::calibration::Offset;
use crate::estimator::solve_object;
use crate::evaluation::{GroundTruth, read_image};
use crate::model::{KeypointModel, PoseFile, Reference, ReferenceView, write_atomically};
use crate::vision::{ImageLimits, decode};

#[derive(Args, Debug)]
#[expect(clippy::doc_markdown, reason = "the comments are the help text")]
pub(super) struct Calibrate {
    /// Name of the object: its folder in the models folder.
    object: String,
    /// BOP scene folder (with scene_gt.json, scene_gt_info.json, scene_camera.json, rgb/) that holds the reference image.
    #[arg(long, value_name = "DIR")]
    scene: PathBuf,
    /// The reference image's number in the scene.
    #[arg(long, value_name = "ID")]
    image: u32,
    #[command(flatten)]
    models: ModelArgs,
}

/// A reference with fewer agreeing keypoints would spoil every later answer.
const MIN_INLIERS: usize = 5;

impl Calibrate {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let paths = self.models.paths();
        let mut model = KeypointModel::load_uncalibrated(&paths, &self.object, &self.models.runtime()?)?;
        let (image_path, camera, objects) = read_image(&self.scene, self.image)?;
        let truth = self.find(&objects, model.manifest.obj_id)?;
        let bytes = fs::read(&image_path)?;
        let image = decode(&bytes, &ImageLimits::default())?;
        let camera = camera.with_size(image.width(), image.height())?;
        let solution = solve_object(&mut model, &image, &truth.bounding_box, &camera)??;
        if solution.inlier_count() < MIN_INLIERS {
            return Err(format!(
                "only {} of {} keypoints agree in this image; choose one that shows the object larger and unoccluded",
                solution.inlier_count(),
                solution.residuals().len()
            )
            .into());
        }
        let offset = Offset::measure(&truth.camera_from_object, &solution.pose, &solution.covariance);
        let extension = image_path.extension().and_then(|e| e.to_str()).unwrap_or("jpg");
        let image_name = format!("{}.{extension}", self.object);
        let region = truth.bounding_box;
        let reference = Reference {
            object: self.object.clone(),
            keypoint_model_sha256: model.manifest.model_sha256.clone(),
            views: vec![ReferenceView {
                image: image_name.clone(),
                camera,
                camera_from_object: PoseFile::from(&truth.camera_from_object),
                box_px: [region.x, region.y, region.width, region.height],
                inlier: true,
                residual_deg: 0.0,
                residual_mm: 0.0,
            }],
            offset,
        };
        // The image first: a reference must never name an image that is not there.
        write_atomically(&paths.reference.join(image_name), &bytes)?;
        let path = paths.reference.join(format!("{}.json", self.object));
        reference.write(&path)?;
        println!(
            "{}: {} of {} keypoints agree; offset known to {:.1} mm and {:.2} deg (1 sigma)",
            path.display(),
            solution.inlier_count(),
            solution.residuals().len(),
            1e3 * reference.offset.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt(),
            reference.offset.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt().to_degrees(),
        );
        Ok(())
    }

    fn find<'a>(&self, objects: &'a [GroundTruth], obj_id: u32) -> Result<&'a GroundTruth, String> {
        let mut matching = objects.iter().filter(|truth| truth.obj_id == obj_id);
        let object = format!("object {obj_id} ({})", self.object);
        match (matching.next(), matching.next()) {
            (Some(truth), None) if truth.bounding_box.extent() >= 16.0 => Ok(truth),
            (Some(_), None) => Err(format!("{object} is not visible in image {}", self.image)),
            (Some(_), Some(_)) => Err(format!("{object} is in image {} more than once", self.image)),
            (None, _) => Err(format!("{object} is not in image {}", self.image)),
        }
    }
}
