use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};
use posed_core::geometry::{ContinuousSymmetry, Pose, Symmetries};

use crate::scene::Scene;

fn half_turn(axis: Vector3<f64>, through: Vector3<f64>) -> Pose {
    let rotation = Rotation3::new(axis * PI);
    Pose::new(rotation, through - rotation * through)
}

/// Each view sees the object as another of the poses that look alike: half turns about axes that do not meet its origin.
#[test]
fn views_may_see_different_equals() {
    let through = Vector3::new(0.02, 0.01, -0.01);
    let bar =
        Symmetries::new(&[half_turn(Vector3::x(), through), half_turn(Vector3::y(), through)], Vec::new()).unwrap();
    for (turn, problem) in (0..200).enumerate() {
        let mut scene = Scene::new(50, problem);
        let pose = scene.world_from_points;
        let seen: Vec<_> = (0..4)
            .map(|view| {
                let camera = scene.around();
                let equal = *bar.discrete().iter().cycle().nth(view + turn).unwrap();
                scene.see_at(&(pose * equal), &camera, &camera, 1.0)
            })
            .collect();
        let solution = scene.solve_symmetric(&seen, &bar).unwrap();
        assert!(!solution.doubts.views_disagree, "{problem}: {:?}", solution.views);
        let found = bar.nearest(&solution.world_from_points, &pose);
        assert!(scene.error_m(&found) < 4e-3, "{problem}: {}", scene.error_m(&found));
        // Told without the symmetry, three of four views contradict the rest.
        let blind = scene.solve(&seen);
        assert_eq!(blind.views.iter().filter(|view| view.excluded.is_some()).count(), 3, "{problem}");
    }
}

/// Every view calls another turn of a can its front.
#[test]
fn views_may_see_any_turn_about_an_axis() {
    let axis = ContinuousSymmetry { axis: Vector3::z_axis(), offset_m: Vector3::new(0.01, -0.01, 0.0) };
    let can = Symmetries::new(&[], vec![axis.clone()]).unwrap();
    for problem in 0..200 {
        let mut scene = Scene::new(51, problem);
        let pose = scene.world_from_points;
        let seen: Vec<_> = (0..3)
            .map(|_| {
                let camera = scene.around();
                let turn = axis.turn(3.0 * scene.normal());
                scene.see_at(&(pose * turn), &camera, &camera, 1.0)
            })
            .collect();
        let solution = scene.solve_symmetric(&seen, &can).unwrap();
        assert!(!solution.doubts.views_disagree, "{problem}");
        let found = can.nearest(&solution.world_from_points, &pose);
        assert!(scene.error_m(&found) < 4e-3, "{problem}: {}", scene.error_m(&found));
    }
}
