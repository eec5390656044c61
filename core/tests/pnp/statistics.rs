//! What the covariances promise, over thousands of seeded problems.

use nalgebra::{Matrix2, Matrix6, Vector3, Vector6};
use posed_core::geometry::Pose;
use posed_core::pnp::Status;

use crate::scene::{Scene, Seen, cube, median};

/// 95 % of chi-squared with 6 degrees of freedom.
const CHI2_6_95: f64 = 12.592;

/// Squared Mahalanobis distance of a pose error: 6 on average where the covariance is true.
fn nees(truth: &Pose, pose: &Pose, covariance: &Matrix6<f64>) -> f64 {
    let error: Vector6<f64> = pose.step_to(truth);
    error.dot(&(covariance.cholesky().unwrap().inverse() * error))
}

#[test]
fn covariance_is_true() {
    for unequal in [false, true] {
        let problems = 10_000;
        let (mut sum, mut inside) = (0.0, 0);
        for problem in 0..problems {
            let mut scene = Scene::new(10, problem);
            let points = cube(0.08);
            let seen = if unequal { scene.see_unequally(&points) } else { scene.see(&points, 1.0) };
            let solution = scene.solve(&points, &seen);
            let squared = nees(&scene.pose, &solution.pose, &solution.covariance);
            sum += squared.min(100.0);
            inside += u32::from(squared < CHI2_6_95);
        }
        let (mean, coverage) = (sum / problems as f64, f64::from(inside) / problems as f64);
        println!("unequal {unequal}: NEES {mean:.2}, inside the 95 % ellipsoid {:.1} %", 100.0 * coverage);
        assert!((5.7..6.3).contains(&mean), "mean NEES {mean}, unequal noise: {unequal}");
        assert!((0.94..0.96).contains(&coverage), "coverage {coverage}, unequal noise: {unequal}");
    }
}

/// Where the residuals show that the stated covariances are too small, the answer's covariance becomes what honest ones
/// would have given.
#[test]
fn understated_noise_is_found_out() {
    const ERROR_PX: f64 = 2.2;
    let mut ratios = Vec::new();
    for problem in 0..300 {
        let mut scene = Scene::new(11, problem);
        let points = scene.points_in_shell(12);
        let mut seen = scene.see(&points, 0.0);
        for pixel in &mut seen.pixels {
            *pixel += scene.direction().xy().normalize() * ERROR_PX;
        }
        let solve = |variance: f64| {
            let seen = Seen { pixels: seen.pixels.clone(), covariances: vec![Matrix2::identity() * variance; 12] };
            scene.solve(&points, &seen)
        };
        let (understated, honest) = (solve(1.0), solve(ERROR_PX * ERROR_PX / 2.0));
        if understated.inlier_count() == 12 {
            ratios.push(understated.covariance.trace() / honest.covariance.trace());
        }
    }
    assert!(ratios.len() > 100, "{}", ratios.len());
    let ratio = median(ratios);
    assert!((0.7..1.4).contains(&ratio), "{ratio}");
}

#[test]
fn general_problems_do_not_fail() {
    for (count, allowed) in [(4, 0.027), (6, 0.002), (8, 0.001), (12, 0.0)] {
        let problems = 3000;
        let mut wrong = 0;
        for problem in 0..problems {
            let mut scene = Scene::new(12 + count as u64, problem);
            let points = scene.points_in_shell(count);
            let seen = scene.see(&points, 1.0);
            wrong += u32::from(scene.error_deg(&scene.solve(&points, &seen).pose) > 10.0);
        }
        let share = f64::from(wrong) / problems as f64;
        println!("{count} points: {:.2} % wrong", 100.0 * share);
        assert!(share <= allowed, "{count} points: {wrong} of {problems} wrong");
    }
}

/// Half the error of a solver that takes all points alike.
#[test]
fn covariances_are_used() {
    let (mut weighted, mut alike) = (Vec::new(), Vec::new());
    for problem in 0..1000 {
        let mut scene = Scene::new(30, problem);
        let points = scene.points_in_shell(8);
        let mut seen = scene.see_unequally(&points);
        weighted.push(scene.error_deg(&scene.solve(&points, &seen).pose));
        seen.covariances = vec![Matrix2::identity() * 16.0; 8];
        alike.push(scene.error_deg(&scene.solve(&points, &seen).pose));
    }
    let ratio = median(weighted) / median(alike);
    println!("ratio of median errors {ratio:.2}");
    assert!(ratio <= 0.55, "{ratio}");
}

/// From afar a flat object has two poses. Either may be right: what counts is that it is said.
#[test]
fn planar_ambiguity_is_flagged() {
    for distance in [1.0, 2.0, 4.0] {
        let problems = 1000;
        let (mut flagged, mut unflagged) = (0, 0);
        for problem in 0..problems {
            let mut scene = Scene::new(31, problem).further(distance);
            let points: Vec<_> = scene.points_in_shell(8).into_iter().map(|p| Vector3::new(p.x, p.y, 0.0)).collect();
            let seen = scene.see(&points, 1.0);
            let solution = scene.solve(&points, &seen);
            flagged += u32::from(solution.doubts.planar_ambiguity);
            let wrong = scene.error_deg(&solution.pose) > 10.0;
            unflagged += u32::from(wrong && solution.status == Status::Ok);
            if let (true, Some(other)) = (wrong, solution.alternatives[0]) {
                // The true pose is the other one, with its own covariance.
                assert!(other.covariance.iter().all(|v| v.is_finite()));
            }
        }
        println!("{distance}: {flagged} flagged, {unflagged} wrong and not flagged, of {problems}");
        assert!(f64::from(unflagged) <= 0.015 * problems as f64, "{unflagged} of {problems} wrong and not flagged");
        if distance > 1.5 {
            assert!(f64::from(flagged) > 0.3 * problems as f64, "only {flagged} flagged");
        }
    }
}
