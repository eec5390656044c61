use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, Vector3};
use posed::evaluation::{ModelPoints, ObjectMesh};
use posed_core::geometry::{Camera, ContinuousSymmetry, Pose, Symmetries};
use proptest::prelude::*;

pub(crate) fn camera() -> Camera {
    Camera::pinhole(600.0, 610.0, 319.5, 239.5).unwrap()
}

/// In front of the camera, with any rotation.
pub(crate) fn any_pose() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform2(-0.2..0.2f64), 0.4..1.5f64)
        .prop_map(|(turn, [x, y], z)| Pose::new(Rotation3::new(Vector3::from(turn)), Vector3::new(x, y, z)))
}

pub(crate) fn half_turn(axis: Vector3<f64>) -> Pose {
    Pose::new(Rotation3::new(axis * PI), Vector3::zeros())
}

pub(crate) fn axis_beside_origin() -> ContinuousSymmetry {
    ContinuousSymmetry { axis: Vector3::z_axis(), offset_m: Vector3::new(0.02, -0.01, 0.0) }
}

/// Without symmetry, with discrete ones, and with an axis of revolution.
pub(crate) fn symmetries() -> [Symmetries; 3] {
    let discrete = [half_turn(Vector3::x()), half_turn(Vector3::z())];
    [
        Symmetries::default(),
        Symmetries::new(&discrete, Vec::new()).unwrap(),
        Symmetries::new(&[], vec![axis_beside_origin()]).unwrap(),
    ]
}

/// A wavy can of `rings` times `around` vertices, 12 cm high, about [`axis_beside_origin`].
pub(crate) fn can(rings: u32, around: u32, symmetries: Symmetries) -> ObjectMesh {
    let vertex = |k: u32| {
        let (height, angle) =
            (f64::from(k / around) / f64::from(rings), TAU * f64::from(k % around) / f64::from(around));
        let radius = 0.03 + 0.005 * (20.0 * height).sin();
        axis_beside_origin().offset_m + Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.12 * height - 0.06)
    };
    ObjectMesh { vertices: (0..rings * around).map(vertex).collect(), diameter_m: 0.14, symmetries }
}

pub(crate) fn points(mesh: &ObjectMesh) -> ModelPoints {
    ModelPoints::new(mesh).unwrap()
}
