use nalgebra::{Rotation3, Vector3};
use posed_core::geometry::Pose;
use proptest::prelude::*;

use crate::scene::{Scene, Seen};

fn moved(seen: &Seen, motion: &Pose) -> Seen {
    Seen { world_from_camera: *motion * seen.world_from_camera, ..seen.clone() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Without errors the pose is the true one, whatever the number of views.
    #[test]
    fn exact_views_give_the_exact_pose(problem in 0..1_000_000u64, count in 1..6usize) {
        let mut scene = Scene::new(1, problem);
        let seen: Vec<_> = (0..count).map(|_| { let camera = scene.around(); scene.see(&camera, 0.0) }).collect();
        let solution = scene.solve(&seen);
        prop_assert!(scene.error_m(&solution.world_from_points) < 1e-8, "{}", scene.error_m(&solution.world_from_points));
        prop_assert!(solution.views.iter().all(|view| view.excluded.is_none() && view.residual_px.unwrap() < 1e-3));
    }

    /// Another world frame is only another name: pose and covariance follow it.
    #[test]
    fn the_answer_follows_the_world(
        problem in 0..1_000_000u64,
        turn in prop::array::uniform3(-2.0..2.0f64),
        shift in prop::array::uniform3(-3.0..3.0f64),
    ) {
        let mut scene = Scene::new(2, problem);
        let seen: Vec<_> = (0..3).map(|_| { let camera = scene.around(); scene.see(&camera, 1.0) }).collect();
        let motion = Pose::new(Rotation3::new(Vector3::from(turn)), Vector3::from(shift));
        let here = scene.solve(&seen);
        let there = scene.solve(&seen.iter().map(|seen| moved(seen, &motion)).collect::<Vec<_>>());
        let expected = motion * here.world_from_points;
        prop_assert!(expected.step_to(&there.world_from_points).norm() < 1e-6);
        let covariance = posed_core::geometry::rotated_covariance(motion.rotation(), &here.covariance);
        prop_assert!((covariance - there.covariance).amax() < 1e-3 * covariance.amax());
    }

    /// The order of views decides nothing.
    #[test]
    fn the_order_of_views_does_not_matter(problem in 0..1_000_000u64) {
        let mut scene = Scene::new(3, problem);
        let mut seen: Vec<_> = (0..4).map(|_| { let camera = scene.around(); scene.see(&camera, 1.0) }).collect();
        let forth = scene.solve(&seen);
        seen.reverse();
        let back = scene.solve(&seen);
        prop_assert!(forth.world_from_points.step_to(&back.world_from_points).norm() < 1e-6);
    }
}
