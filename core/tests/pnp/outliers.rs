//! Keypoints that are plainly wrong, which their covariances do not know.

use nalgebra::{Rotation3, Vector2, Vector3};
use posed_core::geometry::Pose;
use posed_core::pnp::Status;
use rand::RngExt as _;

use crate::scene::{Scene, Seen, cube};

/// Shares of wrong poses, and of wrong poses that were called `ok`.
fn failures(
    test: u64,
    outliers: usize,
    spoil: impl Fn(&mut Scene, &[Vector3<f64>], &mut Seen, &[usize]),
) -> (f64, f64) {
    let problems = 3000;
    let (mut wrong, mut accepted) = (0, 0);
    for problem in 0..problems {
        let mut scene = Scene::new(test, problem);
        let points = cube(0.08);
        let mut seen = scene.see(&points, 1.0);
        let victims = scene.choose(outliers, 8);
        spoil(&mut scene, &points, &mut seen, &victims);
        let solution = scene.solve(&points, &seen);
        if scene.error_deg(&solution.pose) > 10.0 {
            wrong += 1;
            accepted += u32::from(solution.status == Status::Ok);
        }
    }
    let shares = (f64::from(wrong) / problems as f64, f64::from(accepted) / problems as f64);
    println!(
        "test {test}, {outliers} outliers: {:.2} % wrong, {:.2} % wrong and ok",
        100.0 * shares.0,
        100.0 * shares.1
    );
    shares
}

#[test]
fn scattered_outliers() {
    for (outliers, wrong_allowed) in [(1, 0.001), (2, 0.003), (3, 0.03)] {
        let (wrong, accepted) = failures(40, outliers, |scene, _, seen, victims| {
            let centre = scene.camera.project(scene.pose.translation()).unwrap();
            for &victim in victims {
                seen.pixels[victim] = centre + Vector2::from_fn(|_, _| scene.rng.random_range(-75.0..75.0));
            }
        });
        assert!(wrong <= wrong_allowed, "{outliers} outliers: {wrong} wrong");
        assert!(accepted <= 0.001, "{outliers} outliers: {accepted} wrong and called ok");
    }
}

/// Outliers that agree with each other on another pose of the same object: seen where a symmetry takes them.
#[test]
fn outliers_of_a_symmetric_part() {
    let (wrong, accepted) = failures(41, 2, |scene, points, seen, victims| {
        let half_turn = Pose::new(Rotation3::new(Vector3::z() * std::f64::consts::PI), Vector3::zeros());
        let mirrored = scene.pose * half_turn;
        for &victim in victims {
            seen.pixels[victim] = scene.camera.project(&mirrored.transform(&points[victim])).unwrap();
        }
    });
    assert!(wrong <= 0.003 && accepted <= 0.001, "{wrong} {accepted}");
}

/// Outliers that belong to the same object a little further on.
#[test]
fn outliers_of_a_neighbour() {
    for (outliers, wrong_allowed, accepted_allowed) in [(2, 0.003, 0.001), (3, 0.02, 0.003)] {
        let (wrong, accepted) = failures(42, outliers, |scene, points, seen, victims| {
            let aside = scene.direction() * 0.1;
            let turn = scene.direction() * 1.0;
            let neighbour = scene.pose.perturbed(&aside, &turn);
            for &victim in victims {
                seen.pixels[victim] = scene.camera.project(&neighbour.transform(&points[victim])).unwrap();
            }
        });
        assert!(wrong <= wrong_allowed && accepted <= accepted_allowed, "{outliers}: {wrong} {accepted}");
    }
}
