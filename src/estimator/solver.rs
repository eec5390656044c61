use fast_image_resize::Resizer;
use image::RgbImage;

use super::answer::{Detection, EstimateError, KeypointPrediction, ObjectPose};
use super::gates::object_pose;
use super::keypoints::{locate_within, solve_judged};
use crate::model::{Backend, KeypointNet, ObjectModel, RuntimeError};
use crate::vision::BoundingBox;
use posed_core::calibration::Offset;
use posed_core::geometry::Camera;
use posed_core::pnp::{PnpError, Solution};

/// One object's keypoint net on its own: for calibration and evaluation with known boxes.
pub struct KeypointSolver<'a> {
    model: &'a ObjectModel,
    network: KeypointNet,
    resizer: Resizer,
}

impl<'a> KeypointSolver<'a> {
    /// # Errors
    /// When the network cannot be run.
    pub fn new(model: &'a ObjectModel, backend: &dyn Backend) -> Result<Self, RuntimeError> {
        Ok(Self { model, network: model.network(backend)?, resizer: Resizer::new() })
    }

    /// The keypoints within one box, and the pose that they give, `camera_from_keypoints`.
    ///
    /// # Errors
    /// When the network fails on the box, or no pose fits its keypoints (inner result).
    pub fn solve(
        &mut self,
        image: &RgbImage,
        region: &BoundingBox,
        camera: &Camera,
    ) -> Result<(KeypointPrediction, Result<Solution, PnpError>), EstimateError> {
        let camera = camera.for_image(image.width(), image.height())?;
        let found = self.locate(image, region)?;
        let solution = solve_judged(&self.model.manifest, &found, image, region, &camera);
        Ok((found, solution))
    }

    /// The keypoints within one box, image pixels.
    ///
    /// # Errors
    /// When the network fails on the box.
    pub fn locate(&mut self, image: &RgbImage, region: &BoundingBox) -> Result<KeypointPrediction, EstimateError> {
        locate_within(&self.model.manifest, &mut self.network, &mut self.resizer, image, region)
    }

    /// The object's pose within one box, judged as if a detector had seen it there with certainty.
    ///
    /// # Errors
    /// When the camera belongs to another image, or the network fails on the box.
    pub fn object_pose(
        &mut self,
        image: &RgbImage,
        region: &BoundingBox,
        camera: &Camera,
        offset: &Offset,
    ) -> Result<ObjectPose, EstimateError> {
        let camera = camera.for_image(image.width(), image.height())?;
        let found = locate_within(&self.model.manifest, &mut self.network, &mut self.resizer, image, region)?;
        let detection = Detection { object: 0, bounding_box: *region, score: 1.0, given: None };
        Ok(object_pose(self.model, offset, detection, &found, image, &camera))
    }
}
