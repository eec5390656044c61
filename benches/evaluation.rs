//! What the errors of one pose cost on a mesh of a quarter of a million vertices.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Rotation3, Vector3};
use posed::evaluation::{Deviation, ModelPoints, ObjectMesh};
use posed_core::geometry::{Camera, ContinuousSymmetry, Pose, Symmetries};

const SIDE: u32 = 510;

fn errors(criterion: &mut Criterion) {
    let half_turn = Pose::new(Rotation3::new(Vector3::x() * PI), Vector3::zeros());
    let axis = ContinuousSymmetry { axis: Vector3::z_axis(), offset_m: Vector3::zeros() };
    let quarters = Pose::new(Rotation3::new(Vector3::z() * FRAC_PI_2), Vector3::zeros());
    let can = Symmetries::new(&[half_turn], vec![axis]);
    // Faces that lie along no axis of the object's frame.
    let tilted = Rotation3::new(Vector3::new(0.4, 0.7, -0.3));
    let tilt = Pose::new(tilted, Vector3::zeros());
    let cube = Symmetries::new(&[half_turn, quarters].map(|motion| tilt * motion * tilt.inverse()), Vec::new());
    let Ok(camera) = Camera::pinhole(600.0, 600.0, 319.5, 239.5) else { return };
    let meshes = [
        ("no symmetry", (0..SIDE * SIDE).map(on_can).collect(), Some(Symmetries::default())),
        ("can", (0..SIDE * SIDE).map(on_can).collect(), can.ok()),
        ("cube", (0..SIDE * SIDE).map(|k| tilted * on_cube(k)).collect(), cube.ok()),
    ];
    for (name, vertices, symmetries) in meshes {
        let Some(symmetries) = symmetries else { return };
        let mesh = ObjectMesh { vertices, diameter_m: 0.17, symmetries };
        let Ok(points) = ModelPoints::new(&mesh) else { return };
        criterion.bench_function(&format!("{name}: prepare"), |b| b.iter(|| ModelPoints::new(black_box(&mesh))));
        let truth = Pose::new(Rotation3::new(Vector3::new(0.5, -0.8, 0.3)), Vector3::new(0.05, 0.02, 0.6));
        // The normal of a face, seen from the camera.
        let normal = truth.rotation() * (tilted * Vector3::z());
        let estimates = [
            ("2 degrees and 3 mm off", Vector3::new(0.001, 0.001, 0.003), Vector3::new(0.0, 0.03, 0.01)),
            ("a tenth of the diameter off", normal * 0.017, Vector3::new(0.0, 0.03, 0.01)),
            ("a fifth of the diameter off", normal * 0.034, Vector3::zeros()),
            ("half the diameter off", normal * 0.085, Vector3::zeros()),
            ("upside down", Vector3::zeros(), Vector3::new(2.2, 2.2, 0.0)),
            ("3 m off", normal * if normal.z > 0.0 { 3.0 } else { -3.0 }, Vector3::zeros()),
        ];
        for (off, shift, turn) in estimates {
            let estimate = truth.perturbed(&shift, &turn);
            criterion.bench_function(&format!("{name}: {off}"), |b| {
                b.iter(|| Deviation::new(&points, &camera, black_box(&estimate), &truth));
            });
        }
    }
}

fn on_can(k: u32) -> Vector3<f64> {
    let (height, angle) = (f64::from(k / SIDE) / f64::from(SIDE), TAU * f64::from(k % SIDE) / f64::from(SIDE));
    let radius = 0.06 + 0.003 * (30.0 * height).sin();
    Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.12 * height - 0.06)
}

fn on_cube(k: u32) -> Vector3<f64> {
    let (face, k) = (k % 6, k / 6);
    let side = SIDE * 100 / 245;
    let [a, b] = [k % side, k / side].map(|step| 0.1 * f64::from(step) / f64::from(side) - 0.05);
    let c = if face % 2 == 0 { 0.05 } else { -0.05 };
    match face / 2 {
        0 => Vector3::new(a, b, c),
        1 => Vector3::new(b, c, a),
        _ => Vector3::new(c, a, b),
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = errors
}
criterion_main!(benches);
