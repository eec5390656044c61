use nalgebra::{Rotation3, Vector3};
use posed::evaluation::{Deviation, ModelPoints, ModelPointsError, ObjectMesh};
use posed_core::geometry::{Pose, Symmetries};
use proptest::prelude::*;

use crate::objects::{any_pose, axis_beside_origin, camera, can, half_turn, points};

fn can_symmetries() -> Symmetries {
    Symmetries::new(&[], vec![axis_beside_origin()]).unwrap()
}

/// Over all vertices, each against each.
fn exact_add_s_m(mesh: &ObjectMesh, estimate: &Pose, truth: &Pose) -> f64 {
    let estimated: Vec<_> = mesh.vertices.iter().map(|vertex| estimate.transform(vertex)).collect();
    let nearest = |vertex: &Vector3<f64>| {
        let squared = estimated.iter().map(|other| (other - truth.transform(vertex)).norm_squared());
        squared.fold(f64::INFINITY, f64::min).sqrt()
    };
    mesh.vertices.iter().map(nearest).sum::<f64>() / mesh.vertices.len() as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// From right to far off.
    #[test]
    fn a_sample_says_what_all_vertices_say(truth in any_pose(), turn in prop::array::uniform3(-1.0..1.0f64), power in -3.0..1.0f64) {
        let mesh = can(60, 90, can_symmetries());
        let points = points(&mesh);
        let size = 10f64.powf(power);
        let estimate = truth.perturbed(&(Vector3::from(turn) * 0.3 * size), &(Vector3::from(turn) * size));
        let exact_m = exact_add_s_m(&mesh, &estimate, &truth);
        let error_m = (points.add_s_m(&estimate, &truth) - exact_m).abs();
        // What is promised, and what is common.
        prop_assert!(points.sampling_radius_m() > 0.0 && points.sampling_radius_m() < 0.02 * points.diameter_m());
        prop_assert!(error_m <= points.sampling_radius_m().max(0.1 * exact_m) + 1e-12);
        prop_assert!(error_m < 0.02 * exact_m + 1e-3 * points.diameter_m(), "{error_m} of {exact_m}");
    }

    #[test]
    fn few_vertices_are_all_searched_for(truth in any_pose(), other in any_pose()) {
        let mesh = can(13, 17, can_symmetries());
        let points = points(&mesh);
        prop_assert!(points.sampling_radius_m() < 1e-15);
        prop_assert!((points.add_s_m(&other, &truth) - exact_add_s_m(&mesh, &other, &truth)).abs() < 1e-12);
    }

    /// All vertices under all poses that look alike, for both of the largest distances.
    #[test]
    fn the_largest_distance_is_found(truth in any_pose(), other in any_pose()) {
        let mesh = can(7, 9, can_symmetries());
        let deviation = Deviation::new(&points(&mesh), &camera(), &other, &truth);
        let mut least = [f64::INFINITY; 2];
        for step in 0..315 {
            let equal = truth * axis_beside_origin().turn(std::f64::consts::TAU * f64::from(step) / 315.0);
            let mut largest = [0.0_f64; 2];
            for vertex in &mesh.vertices {
                let [a, b] = [other, equal].map(|pose| pose.transform(vertex));
                let pixels = (camera().project(&a).unwrap() - camera().project(&b).unwrap()).norm();
                largest = [largest[0].max((a - b).norm()), largest[1].max(pixels)];
            }
            least = [least[0].min(largest[0]), least[1].min(largest[1])];
        }
        prop_assert!((deviation.mssd_m - least[0]).abs() < 1e-12 && (deviation.mspd_px - least[1]).abs() < 1e-9);
    }
}

#[test]
fn a_symmetric_turn_is_wrong_only_without_symmetry() {
    let vertices = [-1.0, -0.5, 0.5, 1.0].map(|x| Vector3::new(0.05 * x, 0.0, 0.0)).to_vec();
    let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
    let turned = truth * half_turn(Vector3::z());
    let symmetric = Symmetries::new(&[half_turn(Vector3::z())], Vec::new()).unwrap();
    let [wrong, right] = [Symmetries::default(), symmetric].map(|symmetries| {
        let mesh = ObjectMesh { vertices: vertices.clone(), diameter_m: 0.1, symmetries };
        Deviation::new(&points(&mesh), &camera(), &turned, &truth)
    });
    assert!(wrong.add_m > 0.05 && wrong.projection_px > 50.0 && wrong.rotation_deg > 179.0);
    assert!((wrong.mssd_m - 0.1).abs() < 1e-12 && (wrong.mspd_px - 100.0).abs() < 1e-9);
    assert!(right.add_m < 1e-9 && right.projection_px < 1e-6 && right.rotation_deg < 1e-6);
    assert!(right.mssd_m < 1e-9 && right.mspd_px < 1e-6);
}

#[test]
fn a_shift_is_measured_in_metres_and_pixels() {
    let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
    let shifted = Pose::new(Rotation3::identity(), Vector3::new(0.009, 0.0, 0.6));
    let vertices = [-1.0, 1.0].map(|x| Vector3::new(0.05 * x, 0.0, 0.0)).to_vec();
    let mesh = ObjectMesh { vertices, diameter_m: 0.1, symmetries: Symmetries::default() };
    let error = Deviation::new(&points(&mesh), &camera(), &shifted, &truth);
    let metres = [error.add_m, error.mssd_m, error.translation_m];
    assert!(metres.iter().all(|value| (value - 0.009).abs() < 1e-12), "{error:?}");
    assert!([error.projection_px, error.mspd_px].iter().all(|value| (value - 9.0).abs() < 1e-9), "{error:?}");
}

#[test]
fn what_has_no_projection_or_is_no_number_is_infinitely_far() {
    let points = points(&can(5, 9, can_symmetries()));
    let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
    let behind = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, -0.6));
    let error = Deviation::new(&points, &camera(), &behind, &truth);
    assert!(error.projection_px.is_infinite() && error.mspd_px.is_infinite());
    assert!((error.mssd_m - 1.2).abs() < 1e-9 && error.add_m.is_finite());
    let nowhere = Pose::new(Rotation3::identity(), Vector3::new(f64::NAN, 0.0, 0.6));
    let error = Deviation::new(&points, &camera(), &nowhere, &truth);
    assert!(error.mssd_m.is_infinite() && error.add_m.is_infinite() && error.rotation_deg.is_infinite());
}

#[test]
fn meshes_that_are_none_are_refused() {
    let mesh = |vertices, diameter_m| ObjectMesh { vertices, diameter_m, symmetries: Symmetries::default() };
    let refused = |mesh| ModelPoints::new(&mesh).map(drop);
    assert_eq!(refused(mesh(Vec::new(), 0.1)), Err(ModelPointsError::NoVertices));
    assert_eq!(refused(mesh(vec![Vector3::new(0.0, f64::NAN, 0.0)], 0.1)), Err(ModelPointsError::NotFinite));
    assert_eq!(refused(mesh(vec![Vector3::zeros()], 0.0)), Err(ModelPointsError::Diameter(0.0)));
}
