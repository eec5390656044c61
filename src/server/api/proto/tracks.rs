//! Streams that track.

use posed_core::geometry::{Covariance6, Pose, rotated_covariance};
use posed_core::tracking::{Options, TrackState};

use super::answers::row_major;
use crate::estimator::{CallerFrames, FollowOptions, Tracked};
use crate::proto;
use crate::server::service::Tracking;

/// What a message asks for; what is 0 has its default.
pub(crate) fn follow_options(message: &proto::TrackSettings) -> FollowOptions {
    let default = FollowOptions::default();
    let or = |value: f64, default: f64| if value == 0.0 { default } else { value };
    let motion = default.motion;
    FollowOptions {
        detect_every: if message.detect_every == 0 { default.detect_every } else { message.detect_every },
        motion: Options {
            velocity_change_m_s: or(message.velocity_change_m_s, motion.velocity_change_m_s),
            turn_change_rad_s: or(message.turn_change_rad_s, motion.turn_change_rad_s),
            error_memory_s: or(message.error_memory_s, motion.error_memory_s),
            max_coast_s: or(message.max_coast_s, motion.max_coast_s),
            forget_s: or(message.forget_s, motion.forget_s),
        },
    }
}

pub(crate) fn tracking(tracking: &Tracking, frames: &CallerFrames) -> proto::Tracking {
    proto::Tracking {
        capture_time: tracking.capture_time,
        delay_ms: tracking.delay.as_secs_f64() * 1e3,
        detected: tracking.detected,
        tracks: tracking.tracks.iter().map(|one| track(one, frames)).collect(),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 32 poses in an answer")]
fn track(tracked: &Tracked, frames: &CallerFrames) -> proto::Track {
    let view = &tracked.view;
    let in_base = |base_from_camera: &Pose| {
        let covariance = rotated_covariance(base_from_camera.rotation(), &tracked.covariance);
        placed(&(*base_from_camera * tracked.camera_from_object), &covariance)
    };
    proto::Track {
        track_id: view.id,
        object: tracked.object.clone(),
        state: proto::TrackState::from(view.state).into(),
        age_s: view.age_s,
        unseen_s: view.unseen_s,
        pose: tracked.pose.map(|place| place as u32),
        jumped: view.jumped,
        camera_from_object: Some((&tracked.camera_from_object).into()),
        covariance: row_major(&tracked.covariance),
        world_from_object: frames.world_from_camera.map(|_| placed(&view.world_from_object, &view.covariance)),
        base_from_object: frames.base_from_camera.as_ref().map(in_base),
        velocity: view.velocity.iter().copied().collect(),
    }
}

fn placed(pose: &Pose, covariance: &Covariance6) -> proto::PlacedPose {
    proto::PlacedPose { transform: Some(pose.into()), covariance: row_major(covariance) }
}

impl From<TrackState> for proto::TrackState {
    fn from(state: TrackState) -> Self {
        match state {
            TrackState::New => Self::New,
            TrackState::Tracked => Self::Tracked,
            TrackState::Coasting => Self::Coasting,
            TrackState::Lost => Self::Lost,
        }
    }
}
