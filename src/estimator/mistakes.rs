//! What people get wrong about poses.

use nalgebra::{Matrix3, Rotation3, Vector3};
use posed_core::geometry::Pose;

/// What may be wrong about a pose `camera_from_…`, and how the pose looks that was meant.
#[derive(Clone, Copy)]
pub(super) struct Mistake {
    pub what: Wrong,
    pub mended: fn(&Pose) -> Pose,
}

#[derive(Clone, Copy)]
pub(super) enum Wrong {
    Millimetres,
    Inverse,
    InverseInMillimetres,
    OpenGl,
    OpenGlInMillimetres,
}

/// Those that are made most often first.
pub(super) const MISTAKES: [Mistake; 5] = [
    Mistake { what: Wrong::Millimetres, mended: in_metres },
    Mistake { what: Wrong::Inverse, mended: Pose::inverse },
    Mistake { what: Wrong::InverseInMillimetres, mended: |pose| in_metres(pose).inverse() },
    Mistake { what: Wrong::OpenGl, mended: in_opencv },
    Mistake { what: Wrong::OpenGlInMillimetres, mended: |pose| in_opencv(&in_metres(pose)) },
];

fn in_metres(pose: &Pose) -> Pose {
    Pose::new(*pose.rotation(), pose.translation() / 1e3)
}

fn in_opencv(pose: &Pose) -> Pose {
    let half_turn = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&[1.0, -1.0, -1.0].into()));
    Pose::new(half_turn, Vector3::zeros()) * *pose
}
