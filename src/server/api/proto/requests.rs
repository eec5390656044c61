//! What a message asks for.

use bytes::Bytes;
use posed_core::geometry::{Camera, Pose, PoseError};
use proto::camera::Model;
use proto::estimate_request::Camera as ChoiceMessage;

use crate::estimator::CallerFrames;
use crate::proto;
use crate::server::service::{CameraChoice, Failure, PoseRequest, RequestedBox};
use crate::vision::{Image, RawImage, RawLayout};

/// Everything but the image.
pub(crate) fn request(message: proto::EstimateRequest) -> Result<PoseRequest, Failure> {
    let camera = match message.camera {
        Some(ChoiceMessage::CameraId(id)) => Some(CameraChoice::Registered(id)),
        Some(ChoiceMessage::InlineCamera(camera)) => Some(CameraChoice::Given(inline_camera(&camera)?)),
        None => None,
    };
    let frame = |field, transform: Option<proto::Transform>| {
        transform.map(|transform| Failure::or_pose(field, transform)).transpose()
    };
    Ok(PoseRequest {
        camera,
        objects: Some(message.objects).filter(|names| !names.is_empty()),
        max_instances: message.max_instances.map(|count| count as usize),
        min_confidence: Some(message.min_confidence),
        allow_resize: message.allow_resize,
        boxes: boxes(message.boxes)?,
        frames: CallerFrames {
            world_from_camera: frame("world_from_camera", message.world_from_camera)?,
            base_from_camera: frame("base_from_camera", message.base_from_camera)?,
        },
        captured_at: Some(message.captured_at).filter(|mark| !mark.is_empty()),
    })
}

/// Boxes of the caller; `None` where there are none, since an empty list is none here.
pub(super) fn boxes(boxes: Vec<proto::ObjectBox>) -> Result<Option<Vec<RequestedBox>>, Failure> {
    if boxes.is_empty() {
        return Ok(None);
    }
    let requested = |(index, message): (usize, proto::ObjectBox)| {
        let missing = || Failure::invalid(format!("'boxes[{index}]' has no 'box'; set it"));
        let proto::BoundingBox { x_px, y_px, width_px, height_px } = message.r#box.ok_or_else(missing)?;
        Ok(RequestedBox { object: message.object, box_px: [x_px, y_px, width_px, height_px] })
    };
    boxes.into_iter().enumerate().map(requested).collect::<Result<_, _>>().map(Some)
}

/// The image that a message brings, encoded or raw.
pub(crate) fn image(encoded: Bytes, raw: Option<proto::RawImage>) -> Result<Image, Failure> {
    let Some(raw) = raw else { return Ok(Image::Encoded(encoded)) };
    if !encoded.is_empty() {
        return Err(Failure::invalid("fields 'image' and 'raw_image' are both set; set only one of them"));
    }
    let proto::RawImage { encoding, width, height, step, data } = raw;
    let raw = encoding.parse().and_then(|encoding| {
        RawImage::new(RawLayout { encoding, width, height, step: Some(step).filter(|step| *step > 0) }, data)
    });
    raw.map(Image::Raw).map_err(|error| Failure::invalid(format!("field 'raw_image': {error}")))
}

pub(super) fn inline_camera(camera: &proto::Camera) -> Result<Camera, Failure> {
    let pinhole = Camera::pinhole(camera.fx, camera.fy, camera.cx, camera.cy)?;
    let model =
        Model::try_from(camera.model).map_err(|_| Failure::invalid("camera field 'model' is not a known model"))?;
    let with_lens = match model {
        Model::Unspecified | Model::Pinhole if camera.distortion.is_empty() => pinhole,
        Model::Unspecified | Model::Pinhole => {
            return Err(Failure::invalid(
                "camera field 'distortion' is set; set 'model' to MODEL_OPENCV or MODEL_FISHEYE",
            ));
        }
        Model::Opencv => pinhole.with_opencv_distortion(&camera.distortion)?,
        Model::Fisheye => pinhole.with_fisheye_distortion(&camera.distortion)?,
    };
    match (camera.width, camera.height) {
        (0, 0) => Ok(with_lens),
        (width, height) => Ok(with_lens.with_size(width, height)?),
    }
}

impl TryFrom<proto::Transform> for Pose {
    type Error = PoseError;

    fn try_from(t: proto::Transform) -> Result<Self, PoseError> {
        let rotation_xyzw = [t.rotation_x, t.rotation_y, t.rotation_z, t.rotation_w];
        Self::from_quaternion_xyzw(rotation_xyzw, [t.translation_x_m, t.translation_y_m, t.translation_z_m])
    }
}
