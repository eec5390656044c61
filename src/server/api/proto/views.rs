//! Several images of one scene.

use posed_core::geometry::{Covariance6, Pose};
use proto::view::Camera as ChoiceMessage;

use super::answers::{answered, row_major};
use super::requests::{boxes, image, inline_camera};
use crate::estimator::{CallerFrames, FusedPose, LeftOut, ViewShare};
use crate::model::Provider;
use crate::proto;
use crate::server::service::{CameraChoice, Failure, PoseRequest, ViewCamera, ViewCameras, ViewsAnswer, ViewsRequest};
use crate::vision::Image;

/// The request, and its images in order.
pub(crate) fn views_request(message: proto::EstimateViewsRequest) -> Result<(ViewsRequest, Vec<Image>), Failure> {
    let proto::EstimateViewsRequest {
        rig_id,
        views,
        world_from_rig,
        objects,
        max_instances,
        min_confidence,
        allow_resize,
        captured_at,
    } = message;
    let is_rig = !rig_id.is_empty();
    let (mut cameras, mut images) = (Vec::new(), Vec::with_capacity(views.len()));
    for (view, mut message) in views.into_iter().enumerate() {
        images.push(image(std::mem::take(&mut message.image), message.raw_image.take())?);
        if is_rig {
            if !message.boxes.is_empty() {
                return Err(Failure::invalid(format!(
                    "'views[{view}].boxes' is not for 'rig_id'; set 'views' with cameras"
                )));
            }
            if message.camera.is_some() || message.world_from_camera.is_some() {
                return Err(Failure::invalid(format!(
                    "field 'rig_id' is set, and 'views[{view}]' has a camera of its own; set only one of them"
                )));
            }
        } else {
            cameras.push(view_camera(message, view)?);
        }
    }
    let world_from_rig = world_from_rig.map(|pose| Failure::or_pose("world_from_rig", pose)).transpose()?;
    let cameras = match (is_rig, world_from_rig) {
        (true, world_from_rig) => ViewCameras::Rig { id: rig_id, world_from_rig },
        (false, None) => ViewCameras::Given(cameras),
        (false, Some(_)) => return Err(Failure::invalid("field 'world_from_rig' is set; set 'rig_id', too")),
    };
    let common = PoseRequest {
        camera: None,
        objects: Some(objects).filter(|names| !names.is_empty()),
        max_instances: max_instances.map(|count| count as usize),
        min_confidence: Some(min_confidence),
        allow_resize,
        boxes: None,
        frames: CallerFrames::default(),
        captured_at: Some(captured_at).filter(|mark| !mark.is_empty()),
    };
    PoseRequest::check_names(common.objects.as_deref())?;
    Ok((ViewsRequest { cameras, common }, images))
}

fn view_camera(message: proto::View, view: usize) -> Result<ViewCamera, Failure> {
    let missing = |field: &str| Failure::invalid(format!("'views[{view}]' has no {field}; set it, or use 'rig_id'"));
    let camera = match message.camera.ok_or_else(|| missing("camera"))? {
        ChoiceMessage::CameraId(id) => CameraChoice::Registered(id),
        ChoiceMessage::InlineCamera(camera) => CameraChoice::Given(inline_camera(&camera)?),
    };
    let pose = message.world_from_camera.ok_or_else(|| missing("world_from_camera"))?;
    let covariance = match message.covariance[..] {
        [] => None,
        ref values if values.len() == 36 => Some(Covariance6::from_row_slice(values)),
        ref values => {
            let message = format!("'views[{view}].covariance' has {} values; give 36, or none", values.len());
            return Err(Failure::invalid(message));
        }
    };
    let world_from_camera = Failure::or_pose(&format!("views[{view}].world_from_camera"), pose)?;
    Ok(ViewCamera { camera, world_from_camera, covariance, boxes: boxes(message.boxes)? })
}

pub(crate) fn views_response(
    answer: &ViewsAnswer,
    captured_at: Option<String>,
    provider: Provider,
) -> proto::EstimateViewsResponse {
    let frames = CallerFrames::default();
    let alone = |view| answered(view, &frames, String::new(), provider);
    proto::EstimateViewsResponse {
        objects: answer.fused.iter().map(fused_pose).collect(),
        views: answer.views.iter().map(alone).collect(),
        captured_at: captured_at.unwrap_or_default(),
    }
}

fn fused_pose(fused: &FusedPose) -> proto::FusedPose {
    let placed = |(pose, covariance): &(Pose, Covariance6)| proto::PlacedPose {
        transform: Some(pose.into()),
        covariance: row_major(covariance),
    };
    proto::FusedPose {
        object: fused.object.clone(),
        status: proto::Status::from(fused.verdict.status).into(),
        reasons: fused.verdict.reasons.iter().map(|reason| proto::Reason::from(reason).into()).collect(),
        confidence: fused.confidence,
        world_from_object: fused.pose.as_ref().map(placed),
        views: fused.views.iter().map(view_share).collect(),
        view_angle_rad: fused.view_angle_rad,
        scale: fused.scale.map(|scale| scale.value),
        scale_sigma: fused.scale.map(|scale| scale.sigma),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 64 views, 32 poses, 16 keypoints")]
fn view_share(share: &ViewShare) -> proto::ViewShare {
    let left_out = match share.left_out {
        None => proto::view_share::LeftOut::Unspecified,
        Some(LeftOut::Contradicts) => proto::view_share::LeftOut::Contradicts,
        Some(LeftOut::Rejected) => proto::view_share::LeftOut::Rejected,
        Some(LeftOut::NoBaseline) => proto::view_share::LeftOut::NoBaseline,
    };
    proto::ViewShare {
        view: share.view as u32,
        pose: share.place as u32,
        left_out: left_out.into(),
        residual_px: share.residual_px,
        inliers: share.inliers as u32,
        camera_from_object: share.camera_from_object.as_ref().map(Into::into),
    }
}
