//! What an answer says.

use posed_core::geometry::{Covariance6, Pose};
use posed_core::pnp::Status;

use crate::estimator::{Answer, CallerFrames, ObjectPose, Reason, SolvedKeypoint, SolvedPose};
use crate::model::{Library, Provider};
use crate::proto;
use crate::server::service::{KnownObject, Options};

#[expect(clippy::cast_possible_truncation, reason = "at most 16 keypoints")]
pub(crate) fn known_object(object: &KnownObject) -> proto::KnownObject {
    let manifest = &object.model.manifest;
    proto::KnownObject {
        name: manifest.name.clone(),
        obj_id: manifest.obj_id,
        calibrated: object.reference.is_some(),
        diameter_m: manifest.diameter_m,
        keypoints: manifest.virtual_keypoints_m.len() as u32,
        model_sha256: manifest.model_sha256.clone(),
        reference_sha256: object.reference.as_ref().map(|in_force| in_force.sha256.clone()).unwrap_or_default(),
        reference_problem: object.reference_problem.clone().unwrap_or_default(),
        detector_sha256: object.detector.as_ref().map(|one| one.manifest.model_sha256.clone()).unwrap_or_default(),
    }
}

pub(crate) fn response(answer: &Answer, options: &Options, provider: Provider) -> proto::EstimateResponse {
    answered(answer, &options.frames, options.captured_at.clone().unwrap_or_default(), provider)
}

#[expect(clippy::cast_possible_truncation, reason = "a batch of at most 256 images")]
pub(super) fn answered(
    answer: &Answer,
    frames: &CallerFrames,
    captured_at: String,
    provider: Provider,
) -> proto::EstimateResponse {
    let milliseconds = |duration: std::time::Duration| duration.as_secs_f64() * 1e3;
    let timings = &answer.estimate.timings;
    let (scaled_from_width, scaled_from_height) = answer.estimate.camera_scaled_from.unwrap_or_default();
    proto::EstimateResponse {
        image_width: answer.estimate.width,
        image_height: answer.estimate.height,
        timings: Some(proto::Timings {
            queue_ms: milliseconds(answer.queued),
            decode_ms: milliseconds(answer.decode),
            detect_ms: milliseconds(timings.detect),
            keypoints_ms: milliseconds(timings.keypoints),
            pnp_ms: milliseconds(timings.pnp),
            total_ms: milliseconds(answer.total),
            batch_size: answer.batch_size as u32,
        }),
        poses: answer.estimate.poses.iter().map(|found| object_pose(found, frames)).collect(),
        truncated: answer.estimate.truncated,
        captured_at,
        exif_orientation: answer.exif.orientation.into(),
        exif_applied: answer.exif.applied,
        camera_scaled_from_width: scaled_from_width,
        camera_scaled_from_height: scaled_from_height,
        models: Some(models(&answer.estimate.catalogue.library, provider)),
        hints: answer.estimate.hints.iter().map(ToString::to_string).collect(),
    }
}

fn models(library: &Library, provider: Provider) -> proto::Models {
    let shared = library.shared_detector();
    proto::Models {
        provider: provider.to_string(),
        detector_sha256: shared.map(|detector| detector.manifest.model_sha256.clone()).unwrap_or_default(),
        keypoints_sha256: library.keypoint_nets().into_iter().collect(),
        own_detectors_sha256: library.own_detectors().into_iter().collect(),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 32 boxes")]
fn object_pose(found: &ObjectPose, frames: &CallerFrames) -> proto::ObjectPose {
    let region = found.detection.bounding_box;
    proto::ObjectPose {
        object: found.object.clone(),
        status: proto::Status::from(found.verdict.status).into(),
        reasons: found.verdict.reasons.iter().map(|reason| proto::Reason::from(reason).into()).collect(),
        r#box: Some(proto::BoundingBox {
            x_px: region.x,
            y_px: region.y,
            width_px: region.width,
            height_px: region.height,
        }),
        score: found.detection.score,
        solved: found.pose.as_ref().map(|solved| solved_pose(solved, frames)),
        confidence: found.confidence(),
        given_box: found.detection.given.map(|place| place as u32),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 16 keypoints")]
fn solved_pose(solved: &SolvedPose, frames: &CallerFrames) -> proto::SolvedPose {
    let placed = |frame: &Pose| {
        let (pose, covariance) = solved.in_frame(frame);
        proto::PlacedPose { transform: Some((&pose).into()), covariance: row_major(&covariance) }
    };
    proto::SolvedPose {
        camera_from_object: Some((&solved.camera_from_object).into()),
        covariance: row_major(&solved.covariance),
        reprojection_rmse_px: solved.reprojection_rmse_px,
        inliers: solved.inlier_count() as u32,
        keypoints: solved.keypoints.iter().map(Into::into).collect(),
        keypoints_outside_lens: solved.outside_lens as u32,
        weight: solved.weight,
        keypoints_scale: solved.keypoints_scale,
        alternatives: solved
            .alternatives
            .iter()
            .map(|(pose, weight)| proto::Alternative { camera_from_object: Some(pose.into()), weight: *weight })
            .collect(),
        world_from_object: frames.world_from_camera.as_ref().map(placed),
        base_from_object: frames.base_from_camera.as_ref().map(placed),
    }
}

/// Symmetric, so column-major storage reads the same as row-major.
pub(super) fn row_major(covariance: &Covariance6) -> Vec<f64> {
    covariance.iter().copied().collect()
}

impl From<&SolvedKeypoint> for proto::Keypoint {
    fn from(keypoint: &SolvedKeypoint) -> Self {
        Self {
            u_px: keypoint.pixel.x,
            v_px: keypoint.pixel.y,
            residual_px: keypoint.residual_px,
            peak: keypoint.peak,
            inlier: keypoint.inlier,
        }
    }
}

impl From<&Pose> for proto::Transform {
    fn from(pose: &Pose) -> Self {
        let [rotation_x, rotation_y, rotation_z, rotation_w] = pose.rotation_xyzw();
        let [translation_x_m, translation_y_m, translation_z_m] = pose.translation_m();
        Self { rotation_x, rotation_y, rotation_z, rotation_w, translation_x_m, translation_y_m, translation_z_m }
    }
}

impl From<Status> for proto::Status {
    fn from(status: Status) -> Self {
        match status {
            Status::Ok => Self::Ok,
            Status::Ambiguous => Self::Ambiguous,
            Status::LowConfidence => Self::LowConfidence,
            Status::Rejected => Self::Rejected,
        }
    }
}

impl From<Reason> for proto::Reason {
    fn from(reason: Reason) -> Self {
        match reason {
            Reason::FewInliers => Self::FewInliers,
            Reason::HighResidual => Self::HighResidual,
            Reason::PlanarAmbiguity => Self::PlanarAmbiguity,
            Reason::TwoAnswers => Self::TwoAnswers,
            Reason::BoxMismatch => Self::BoxMismatch,
            Reason::WeakKeypoints => Self::WeakKeypoints,
            Reason::NoPose => Self::NoPose,
            Reason::UncertainPose => Self::UncertainPose,
            Reason::TooNear => Self::TooNear,
            Reason::CameraSuspect => Self::CameraSuspect,
            Reason::GreyImage => Self::GreyImage,
            Reason::DarkImage => Self::DarkImage,
            Reason::Improbable => Self::Improbable,
            Reason::NotFinite => Self::NotFinite,
            Reason::ViewsDisagree => Self::ViewsDisagree,
            Reason::SingleView => Self::SingleView,
            Reason::WeakBaseline => Self::WeakBaseline,
        }
    }
}
