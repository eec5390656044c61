//! What the part `request` of a form may say.

use posed_core::calibration::Mode;
use serde::Deserialize;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::forms::{CameraChoiceForm, PoseForm, RawForm};
use crate::estimator::CallerFrames;
use crate::server::service::{CameraChoice, Failure, KnownView, PoseRequest};
use crate::vision::RawLayout;

/// The part `request` of a form. Unknown fields are refused.
#[derive(Clone, Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct EstimateRequest {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoiceForm)]
    camera: Option<CameraChoice>,
    /// Names of the objects to look for; all calibrated ones by default.
    objects: Option<Vec<String>>,
    /// At most this many of each object.
    #[schema(minimum = 1)]
    max_instances: Option<usize>,
    /// Poses with less confidence are left out, 0..1.
    #[schema(minimum = 0, maximum = 1)]
    min_confidence: Option<f64>,
    /// The camera's pose in the world: then the answer has poses in the world's frame, too.
    world_from_camera: Option<PoseForm>,
    /// The camera's pose in the robot's base: then the answer has poses in the base's frame, too.
    base_from_camera: Option<PoseForm>,
    /// Your own mark of the image, such as its capture time: given back as it is, at most 64 characters.
    captured_at: Option<String>,
    /// The part `image` is a raw frame of this layout, not an encoded image.
    raw: Option<RawForm>,
}

impl EstimateRequest {
    /// What is asked, and the layout of a raw frame.
    pub(crate) fn translate(self) -> Result<(PoseRequest, Option<RawLayout>), Failure> {
        let frame = |field, form: Option<PoseForm>| form.map(|form| Failure::or_pose(field, form)).transpose();
        let frames = CallerFrames {
            world_from_camera: frame("world_from_camera", self.world_from_camera)?,
            base_from_camera: frame("base_from_camera", self.base_from_camera)?,
        };
        let raw = self.raw.map(RawLayout::try_from).transpose();
        let raw = raw.map_err(|error| Failure::invalid(format!("field 'raw': {error}")))?;
        let Self { camera, objects, max_instances, min_confidence, captured_at, .. } = self;
        Ok((PoseRequest { camera, objects, max_instances, min_confidence, frames, captured_at }, raw))
    }
}

/// One set of options for all images of a form, or one for each.
#[derive(Deserialize)]
#[serde(transparent)]
pub(crate) struct BatchRequest(Box<RawValue>);

impl BatchRequest {
    /// One request for each image. One that cannot be read spoils its own image alone.
    pub(crate) fn for_each(&self, images: usize) -> Result<Vec<Result<EstimateRequest, Failure>>, Failure> {
        let bad = |error: serde_json::Error| Failure::invalid(format!("part 'request': {error}"));
        let text = self.0.get();
        if !text.trim_start().starts_with('[') {
            let shared: EstimateRequest = serde_json::from_str(text).map_err(bad)?;
            return Ok(vec![shared; images].into_iter().map(Ok).collect());
        }
        let list: Vec<&RawValue> = serde_json::from_str(text).map_err(bad)?;
        if list.len() != images {
            let message = format!("part 'request' lists {} options for {images} images", list.len());
            return Err(Failure::invalid(message));
        }
        Ok(list.into_iter().map(|one| serde_json::from_str(one.get()).map_err(bad)).collect())
    }
}

/// The part `request` of a recalibration. Unknown fields are refused.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReferenceRequest {
    /// One entry for each part `image`, in order.
    references: Vec<ReferenceImage>,
    /// `weighted` (default) or `paper`: how several images become one offset.
    #[serde(default)]
    #[schema(value_type = String, example = "weighted")]
    pub mode: Mode,
}

/// What is known of one reference image.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct ReferenceImage {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoiceForm)]
    camera: CameraChoice,
    /// The object's pose in this image.
    camera_from_object: PoseForm,
    /// The object's box: x, y, width, height in pixels. By default the only one that the detector sees.
    box_px: Option<[f64; 4]>,
}

impl ReferenceRequest {
    /// The images with what is known of them.
    pub(crate) fn views(self, images: Vec<bytes::Bytes>) -> Result<Vec<KnownView>, Failure> {
        if images.is_empty() || images.len() != self.references.len() {
            let (images, references) = (images.len(), self.references.len());
            let message = format!("{images} parts 'image' for {references} entries in 'references'");
            return Err(Failure::invalid(message));
        }
        let known = |(image, known): (bytes::Bytes, ReferenceImage)| {
            Ok(KnownView {
                image,
                camera: known.camera,
                camera_from_object: Failure::or_pose("camera_from_object", known.camera_from_object)?,
                region: known.box_px.map(Into::into),
            })
        };
        images.into_iter().zip(self.references).map(known).collect()
    }
}
