//! The part `request` of a form.

use serde::Deserialize;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::forms::{BoxForm, CameraChoiceForm, PoseForm, PoseSchema, RawForm};
use super::read_request;
use crate::estimator::CallerFrames;
use crate::server::service::{CameraChoice, Failure, PoseRequest};
use crate::vision::RawLayout;

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
    /// Where the objects are, from a detector of your own: the server's detectors do not look then. Each box gets a pose. Objects
    /// that are in no detector's labels need this. At most `max_detections` of `GET /v1/limits`; not together with `objects`.
    boxes: Option<Vec<BoxForm>>,
    /// Pose of the camera in the world frame. If set, the answer also has each pose in the world frame.
    #[schema(value_type = Option<PoseSchema>)]
    world_from_camera: Option<PoseForm>,
    /// Pose of the camera in the frame of the robot's base. If set, the answer also has each pose in the base frame.
    #[schema(value_type = Option<PoseSchema>)]
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
        let raw = self.raw.map(RawForm::layout).transpose()?;
        let boxes = BoxForm::all(self.boxes);
        let Self { camera, objects, max_instances, min_confidence, allow_resize, captured_at, .. } = self;
        let request =
            PoseRequest { camera, objects, max_instances, min_confidence, allow_resize, boxes, frames, captured_at };
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
        let text = self.0.get();
        if !text.trim_start().starts_with('[') {
            let shared: EstimateRequest = read_request(text.as_bytes())?;
            if shared.boxes.is_some() && images > 1 {
                let message = "field 'boxes' is of one image; list options for each image, each with its own boxes";
                return Err(Failure::invalid(message));
            }
            // Checked before it is copied.
            PoseRequest::check_names(shared.objects.as_deref())?;
            return Ok(vec![shared; images].into_iter().map(Ok).collect());
        }
        let list: Vec<&RawValue> = read_request(text.as_bytes())?;
        if list.len() != images {
            let given = list.len();
            let message = format!("part 'request' lists {given} options for {images} images; list one for each image");
            return Err(Failure::invalid(message));
        }
        Ok(list.into_iter().map(|one| read_request(one.get().as_bytes())).collect())
    }
}
