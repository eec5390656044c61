//! Without noise the answer is exact, and it is one answer.

use nalgebra::{Matrix2, Vector2, Vector3};
use posed_core::geometry::Pose;
use posed_core::pnp::{Options, Solution, solve};
use proptest::prelude::*;

use crate::scene::{Scene, Seen, cube};

/// The angle (degrees) from the true pose to the nearest mode: with four points several modes may be exact.
fn nearest_mode(scene: &Scene, solution: &Solution) -> f64 {
    let alternatives = solution.alternatives.iter().flatten().map(|a| a.pose);
    let poses = std::iter::once(solution.pose).chain(alternatives);
    poses.map(|pose: Pose| scene.error_deg(&pose)).fold(f64::INFINITY, f64::min)
}

fn unit(pixels: Vec<Vector2<f64>>) -> Seen {
    Seen { covariances: vec![Matrix2::identity(); pixels.len()], pixels }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Of general, nearly flat and flat sets.
    #[test]
    fn recovers_the_pose(problem in any::<u32>(), count in 4..=12usize, flatness in prop::sample::select(vec![1.0, 0.1, 0.01, 0.0])) {
        let mut scene = Scene::new(1, problem.into());
        let mut points = scene.points_in_shell(count);
        for point in &mut points {
            point.z *= flatness;
        }
        let solution = scene.solve(&points, &unit(scene.project(&points)));
        let apart = nearest_mode(&scene, &solution);
        prop_assert!(apart < 1e-2, "{apart} deg");
        if count > 5 {
            prop_assert!(scene.error_deg(&solution.pose) < 1e-2);
            prop_assert!(solution.chi2 < 1e-6);
        }
    }

    /// With every lens: distortion is undone on the points.
    #[test]
    fn recovers_the_pose_through_a_lens(problem in any::<u32>(), fisheye in any::<bool>()) {
        let mut scene = Scene::new(2, problem.into());
        scene.camera = if fisheye {
            scene.camera.with_fisheye_distortion(&[0.05, -0.01, 0.003, -0.001]).unwrap()
        } else {
            scene.camera.with_opencv_distortion(&[-0.25, 0.08, 0.001, -0.002, 0.01]).unwrap()
        };
        let points = scene.points_in_shell(8);
        let solution = scene.solve(&points, &unit(scene.project(&points)));
        prop_assert!(scene.error_deg(&solution.pose) < 1e-3);
        prop_assert!((solution.pose.translation() - scene.pose.translation()).norm() < 1e-6);
    }

    /// Naming the points in another order changes nothing but rounding, where none is on the verge of being an outlier.
    #[test]
    fn order_does_not_matter(problem in any::<u32>(), turn in 1..8usize) {
        let mut scene = Scene::new(3, problem.into());
        let mut points = cube(0.08);
        let mut seen = scene.see(&points, 1.0);
        let before = scene.solve(&points, &seen);
        points.rotate_left(turn);
        seen.pixels.rotate_left(turn);
        let after = scene.solve(&points, &seen);
        prop_assume!(before.residuals().iter().chain(after.residuals()).all(|r| r.squared < 6.0));
        prop_assert!(before.pose.angle_to(&after.pose) < 1e-4);
        prop_assert!((before.pose.translation() - after.pose.translation()).norm() < 1e-5);
    }
}

#[test]
fn same_input_same_bits() {
    for problem in 0..100 {
        let mut scene = Scene::new(4, problem);
        let points = cube(0.08);
        let seen = scene.see(&points, 2.0);
        let [first, second] = [scene.solve(&points, &seen), scene.solve(&points, &seen)];
        assert_eq!(first.pose, second.pose);
        assert_eq!(first.covariance, second.covariance);
        assert_eq!(first.residuals(), second.residuals());
    }
}

#[test]
fn residuals_are_projection_minus_pixel() {
    let mut scene = Scene::new(5, 0);
    let points = cube(0.08);
    let mut seen = scene.see(&points, 0.5);
    seen.pixels[3] += Vector2::new(40.0, -25.0);
    let solution = scene.solve(&points, &seen);
    for (index, residual) in solution.residuals().iter().enumerate() {
        let expected = scene.camera.project(&solution.pose.transform(&points[index])).unwrap() - seen.pixels[index];
        assert!((residual.error_px - expected).norm() < 1e-9);
        assert!((residual.squared - expected.norm_squared() / 0.25).abs() < 1e-6 * residual.squared);
        assert_eq!(residual.inlier, index != 3);
    }
    assert!(solution.rmse_px() < 1.5);
}

/// A track's previous pose decides nothing that the points do not leave open.
#[test]
fn a_wrong_previous_pose_does_no_harm() {
    for problem in 0..300 {
        let mut scene = Scene::new(6, problem);
        let points = cube(0.08);
        let seen = scene.see(&points, 1.0);
        let stray = Pose::new(*scene.pose.rotation(), Vector3::new(0.1, 0.1, 2.0))
            .perturbed(&Vector3::zeros(), &Vector3::new(2.0, 1.0, 0.0));
        let with = |previous| {
            let options = Options { floor_px: 0.0, previous, ..Options::default() };
            solve(&points, &seen.pixels, &seen.covariances, &scene.camera, &options).unwrap().pose
        };
        assert!(with(Some(stray)).angle_to(&with(None)) < 1e-4);
    }
}
