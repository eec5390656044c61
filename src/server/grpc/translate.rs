//! Estimates to protobuf messages.

use crate::estimator::{Answer, ObjectPose, SolvedPose};
use crate::geometry::Pose;
use crate::pnp::{Reason, Status};
use crate::proto;

impl From<Answer> for proto::EstimateResponse {
    fn from(answer: Answer) -> Self {
        let milliseconds = |duration: std::time::Duration| duration.as_secs_f64() * 1e3;
        let Answer { estimate, queued, decode, total } = answer;
        Self {
            image_width: estimate.width,
            image_height: estimate.height,
            timings: Some(proto::Timings {
                queue_ms: milliseconds(queued),
                decode_ms: milliseconds(decode),
                detect_ms: milliseconds(estimate.timings.detect),
                keypoints_ms: milliseconds(estimate.timings.keypoints),
                pose_ms: milliseconds(estimate.timings.pose),
                total_ms: milliseconds(total),
            }),
            poses: estimate.poses.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<ObjectPose> for proto::ObjectPose {
    fn from(found: ObjectPose) -> Self {
        let region = found.detection.bounding_box;
        Self {
            object: found.object,
            status: proto::Status::from(found.verdict.status).into(),
            reasons: found.verdict.reasons.iter().map(|reason| proto::Reason::from(reason).into()).collect(),
            r#box: Some(proto::BoundingBox {
                x_px: region.x,
                y_px: region.y,
                width_px: region.width,
                height_px: region.height,
            }),
            score: found.detection.score,
            solved: found.pose.as_ref().map(Into::into),
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "counts of at most 16 keypoints")]
impl From<&SolvedPose> for proto::SolvedPose {
    fn from(solved: &SolvedPose) -> Self {
        Self {
            camera_from_object: Some((&solved.camera_from_object).into()),
            // Symmetric, so column-major storage reads the same as row-major.
            covariance: solved.covariance.iter().copied().collect(),
            reprojection_rmse_px: solved.reprojection_rmse_px,
            inliers: solved.inliers as u32,
            keypoints: solved.keypoints as u32,
            weight: solved.weight,
            alternatives: solved
                .alternatives
                .iter()
                .map(|(pose, weight)| proto::Alternative { camera_from_object: Some(pose.into()), weight: *weight })
                .collect(),
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
            Reason::BoxMismatch => Self::BoxMismatch,
            Reason::WeakKeypoints => Self::WeakKeypoints,
            Reason::NoPose => Self::NoPose,
            Reason::UncertainPose => Self::UncertainPose,
        }
    }
}
