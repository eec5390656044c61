//! The part `request` of a form.

use posed_core::calibration::Mode;
use serde::Deserialize;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::forms::{CameraChoiceForm, PoseForm, RawForm};
use crate::estimator::CallerFrames;
use crate::server::service::{CameraChoice, Failure, KnownView, PoseRequest};
use crate::vision::{BoundingBox, RawLayout};

/// The part `request` of a form. Unknown fields are an error.
#[derive(Clone, Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct EstimateRequest {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoiceForm)]
    camera: Option<CameraChoice>,
    /// Names of the objects to look for. Omit this to look for all calibrated objects.
    objects: Option<Vec<String>>,
    /// Maximum number of poses of each object. Omit this for no maximum.
    #[schema(minimum = 1)]
    max_instances: Option<usize>,
    /// Minimum confidence, 0..1. The answer omits poses below it.
    #[schema(minimum = 0, maximum = 1)]
    min_confidence: Option<f64>,
    /// Whether an image of another size than the camera's is its full frame, resized: the parameters are then scaled.
    #[serde(default)]
    allow_resize: bool,
    /// Pose of the camera in the world frame. If set, the answer also has each pose in the world frame.
    world_from_camera: Option<PoseForm>,
    /// Pose of the camera in the frame of the robot's base. If set, the answer also has each pose in the base frame.
    base_from_camera: Option<PoseForm>,
    /// Your label for the image, such as its capture time. The answer repeats it. At most 64 characters.
    captured_at: Option<String>,
    /// Layout of the part `image`, if that is a raw frame. Omit this for an encoded image.
    raw: Option<RawForm>,
}

impl EstimateRequest {
    /// Splits the form into the request and the layout of a raw frame.
    pub(crate) fn translate(self) -> Result<(PoseRequest, Option<RawLayout>), Failure> {
        let frame = |field, form: Option<PoseForm>| form.map(|form| Failure::or_pose(field, form)).transpose();
        let frames = CallerFrames {
            world_from_camera: frame("world_from_camera", self.world_from_camera)?,
            base_from_camera: frame("base_from_camera", self.base_from_camera)?,
        };
        let raw = self.raw.map(RawLayout::try_from).transpose();
        let raw = raw.map_err(|error| Failure::invalid(format!("field 'raw': {error}")))?;
        let Self { camera, objects, max_instances, min_confidence, allow_resize, captured_at, .. } = self;
        let request = PoseRequest { camera, objects, max_instances, min_confidence, allow_resize, frames, captured_at };
        Ok((request, raw))
    }
}

/// One set of options for all images of a form, or one for each image.
#[derive(Deserialize)]
#[serde(transparent)]
pub(crate) struct BatchRequest(Box<RawValue>);

impl BatchRequest {
    /// Returns one request for each image. An unreadable one fails its own image only.
    pub(crate) fn for_each(&self, images: usize) -> Result<Vec<Result<EstimateRequest, Failure>>, Failure> {
        let bad = |error: serde_json::Error| Failure::invalid(format!("part 'request': {error}"));
        let text = self.0.get();
        if !text.trim_start().starts_with('[') {
            let shared: EstimateRequest = serde_json::from_str(text).map_err(bad)?;
            // Checked before it is copied.
            PoseRequest::check_names(shared.objects.as_deref())?;
            return Ok(vec![shared; images].into_iter().map(Ok).collect());
        }
        let list: Vec<&RawValue> = serde_json::from_str(text).map_err(bad)?;
        if list.len() != images {
            let given = list.len();
            let message = format!("part 'request' lists {given} options for {images} images; list one for each image");
            return Err(Failure::invalid(message));
        }
        Ok(list.into_iter().map(|one| serde_json::from_str(one.get()).map_err(bad)).collect())
    }
}

/// The part `request` of a recalibration. Unknown fields are an error.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReferenceRequest {
    /// One entry for each part `image`, in the same order.
    references: Vec<ReferenceImage>,
    /// How several images are averaged: `weighted` (default) weights each image by its information, `paper` does not.
    #[serde(default)]
    #[schema(value_type = String, example = "weighted")]
    pub mode: Mode,
    /// Whether the origin of the object's frame may lie farther from the object than the object is large.
    #[serde(default)]
    pub far_origin: bool,
}

/// The known facts about one reference image.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct ReferenceImage {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoiceForm)]
    camera: CameraChoice,
    /// Pose of the object in this image.
    camera_from_object: PoseForm,
    /// Box of the object: x, y, width, height in pixels. Omit this if the detector finds the object exactly once.
    box_px: Option<[f64; 4]>,
}

/// A box that something can be seen in.
fn checked_box(box_px: [f64; 4]) -> Result<BoundingBox, Failure> {
    let [x, y, width, height] = box_px;
    let usable = [x, y].iter().all(|at| at.abs() <= MAX_BOX_PX)
        && [width, height].iter().all(|side| (MIN_BOX_PX..=MAX_BOX_PX).contains(side));
    let problem = || {
        format!(
            "field 'box_px' is {box_px:?}; give x, y, width, height in pixels, sides from {MIN_BOX_PX} to {MAX_BOX_PX}"
        )
    };
    if usable { Ok(box_px.into()) } else { Err(Failure::invalid(problem())) }
}

const MIN_BOX_PX: f64 = 8.0;
const MAX_BOX_PX: f64 = 8192.0;

impl ReferenceRequest {
    /// Combines the images with their known facts.
    pub(crate) fn views(self, images: Vec<bytes::Bytes>) -> Result<Vec<KnownView>, Failure> {
        if images.is_empty() || images.len() != self.references.len() {
            let (images, references) = (images.len(), self.references.len());
            let message =
                format!("{images} parts 'image' for {references} entries in 'references'; send one image for each");
            return Err(Failure::invalid(message));
        }
        let known = |(image, known): (bytes::Bytes, ReferenceImage)| {
            Ok(KnownView {
                image,
                camera: known.camera,
                camera_from_object: Failure::or_pose("camera_from_object", known.camera_from_object)?,
                region: known.box_px.map(checked_box).transpose()?,
            })
        };
        images.into_iter().zip(self.references).map(known).collect()
    }
}
