//! What the covariances promise, over many seeded scenes.

use nalgebra::{Matrix2, Vector2, Vector3};
use posed_core::geometry::{Covariance6, Symmetries};
use posed_core::pnp::Status;
use posed_core::views::{isotropic_covariance, solve_views};

use crate::scene::{Scene, Seen, exact, median, nees};

/// 95 % of chi-squared with 6 degrees of freedom.
const CHI2_6_95: f64 = 12.592;

fn check(name: &str, nees: &[f64]) {
    let mean = nees.iter().map(|value| value.min(100.0)).sum::<f64>() / nees.len() as f64;
    let coverage = nees.iter().filter(|value| **value < CHI2_6_95).count() as f64 / nees.len() as f64;
    println!("{name}: NEES {mean:.2}, inside the 95 % ellipsoid {:.1} %", 100.0 * coverage);
    assert!((5.6..6.4).contains(&mean), "{name}: mean NEES {mean}");
    assert!((0.935..0.965).contains(&coverage), "{name}: coverage {coverage}");
}

#[test]
fn covariance_is_true_with_exact_cameras() {
    for count in [1, 2, 3, 6] {
        let problems = (0..2000).map(|problem| {
            let mut scene = Scene::new(10 + count, problem);
            let seen: Vec<_> = (0..count)
                .map(|_| {
                    let camera = scene.around();
                    scene.see(&camera, 1.0)
                })
                .collect();
            let solution = scene.solve(&seen);
            nees(&scene.world_from_points, &solution.world_from_points, &solution.covariance)
        });
        check(&format!("{count} views"), &problems.collect::<Vec<_>>());
    }
}

/// A scene whose cameras do not stand quite where they are said to.
fn with_loose_cameras(test: u64, problem: u64, covariance: &Covariance6) -> (Scene, Vec<Seen>) {
    let mut scene = Scene::new(test, problem);
    let seen = (0..3)
        .map(|_| {
            let stated = scene.around();
            let (translation, rotation) = scene.step(covariance);
            let pose = scene.world_from_points;
            let seen = scene.see_at(&pose, &stated.perturbed(&translation, &rotation), &stated, 0.5);
            Seen { camera_covariance: *covariance, ..seen }
        })
        .collect();
    (scene, seen)
}

#[test]
fn covariance_is_true_with_loose_cameras() {
    let covariance = isotropic_covariance(2e-3, 3e-3);
    let problems = (0..2000).map(|problem| {
        let (scene, seen) = with_loose_cameras(20, problem, &covariance);
        let solution = scene.solve(&seen);
        assert!(!solution.doubts.views_disagree && !solution.doubts.high_residual, "{problem}: {:?}", solution.doubts);
        nees(&scene.world_from_points, &solution.world_from_points, &solution.covariance)
    });
    check("loose cameras", &problems.collect::<Vec<_>>());
}

/// Of three cameras one is known badly: its word counts less where that matters, and depth from it is still used.
#[test]
fn a_camera_that_is_known_badly_counts_less() {
    let (mut told, mut not_told) = (Vec::new(), Vec::new());
    let loose = isotropic_covariance(3e-3, 4e-3);
    for problem in 0..400 {
        let mut scene = Scene::new(21, problem);
        let mut seen: Vec<_> = (0..3)
            .map(|_| {
                let camera = scene.around();
                scene.see(&camera, 0.7)
            })
            .collect();
        let stated = seen[0].world_from_camera;
        let (translation, rotation) = scene.step(&loose);
        let pose = scene.world_from_points;
        seen[0] = scene.see_at(&pose, &stated.perturbed(&translation, &rotation), &stated, 0.7);
        not_told.push(scene.error_m(&scene.solve(&seen).world_from_points));
        seen[0].camera_covariance = loose;
        told.push(scene.error_m(&scene.solve(&seen).world_from_points));
    }
    let ratio = median(told) / median(not_told);
    println!("ratio of median errors {ratio:.2}");
    assert!(ratio < 0.75, "{ratio}");
}

/// What the points of one view have in common does not average out over them, and is told apart from what they have not.
#[test]
fn shared_errors_of_a_view_are_allowed_for() {
    let problems = (0..1500).map(|problem| {
        let mut scene = Scene::new(22, problem);
        let seen: Vec<_> = (0..3)
            .map(|_| {
                let camera = scene.around();
                let clean = scene.see(&camera, 1.0);
                // The view sees the object a step off that is as large as its own covariance: twice that in all.
                let own = clean.modes[0].covariance;
                let root = own.cholesky().unwrap().l();
                let step = root * nalgebra::Vector6::from_fn(|_, _| scene.normal());
                let camera_from_points = camera.inverse() * scene.world_from_points;
                let off = camera_from_points
                    .perturbed(&step.fixed_rows::<3>(0).into_owned(), &step.fixed_rows::<3>(3).into_owned());
                let mut seen = scene.see_at(&(camera * off), &camera, &camera, 1.0);
                seen.modes = seen.modes.iter().map(|mode| mode.with_covariance(&(mode.covariance * 2.0))).collect();
                seen
            })
            .collect();
        let views: Vec<_> = seen.iter().map(|seen| scene.view(seen)).collect();
        let solution = solve_views(&scene.points, &views, &Symmetries::default(), &exact()).unwrap();
        nees(&scene.world_from_points, &solution.world_from_points, &solution.covariance)
    });
    check("shared errors", &problems.collect::<Vec<_>>());
}

/// Views that may each see the pose a step off have points that fit wherever a camera is said to stand. The steps tell.
#[test]
fn a_camera_that_stood_elsewhere_shows_in_the_steps() {
    let found_out = |moved_m: f64| {
        let found_out = (0..300).filter(|problem| {
            let mut scene = Scene::new(26, *problem);
            let mut seen: Vec<_> = (0..3)
                .map(|_| {
                    let camera = scene.around();
                    let mut seen = scene.see(&camera, 1.0);
                    seen.modes = seen.modes.iter().map(|mode| mode.with_covariance(&(mode.covariance * 4.0))).collect();
                    seen
                })
                .collect();
            let sideways = seen[0].world_from_camera.rotation() * Vector3::x() * moved_m;
            seen[0].world_from_camera = seen[0].world_from_camera.perturbed(&sideways, &Vector3::zeros());
            let doubts = scene.solve(&seen).doubts;
            doubts.high_residual || doubts.views_disagree
        });
        found_out.count()
    };
    let (at_place, moved) = (found_out(0.0), found_out(0.012));
    println!("{at_place} and {moved} of 300 doubted");
    assert!(at_place < 10 && moved > 270, "{at_place} {moved}");
}

/// Three views know the pose much better than one; that is what they are for.
#[test]
fn more_views_know_more() {
    let error = |count: u64| {
        let errors = (0..500).map(|problem| {
            let mut scene = Scene::new(23, problem);
            let seen: Vec<_> = (0..count)
                .map(|_| {
                    let camera = scene.around();
                    scene.see(&camera, 1.0)
                })
                .collect();
            scene.error_m(&scene.solve(&seen).world_from_points)
        });
        median(errors.collect())
    };
    let (one, two, three) = (error(1), error(2), error(3));
    println!("median errors: {:.2} {:.2} {:.2} mm", 1e3 * one, 1e3 * two, 1e3 * three);
    assert!(two < 0.5 * one && three < 0.8 * two, "{one} {two} {three}");
}

/// The same image twice is no second witness.
#[test]
fn a_view_twice_counts_once() {
    for problem in 0..50 {
        let mut scene = Scene::new(24, problem);
        let camera = scene.around();
        let seen = scene.see(&camera, 1.0);
        let (once, twice) = (scene.solve(std::slice::from_ref(&seen)), scene.solve(&[seen.clone(), seen]));
        assert!(twice.doubts.weak_baseline && !once.doubts.weak_baseline);
        let (a, b) = (once.covariance.determinant(), twice.covariance.determinant());
        assert!((a / b - 1.0).abs() < 0.05, "{problem}: {a} {b}");
    }
}

/// From afar a flat object has two poses in one view. A second view knows which.
#[test]
fn a_second_view_settles_planar_ambiguity() {
    let (mut ambiguous, mut settled, mut wrong) = (0, 0, 0);
    for problem in 0..300 {
        let mut scene = Scene::new(25, problem);
        scene.points = scene.points.iter().map(|p| Vector3::new(p.x, p.y, 0.0)).collect();
        let normal = scene.world_from_points.rotation() * Vector3::z();
        let side = normal.cross(&Vector3::new(scene.normal(), scene.normal(), scene.normal())).normalize();
        let seen: Vec<_> = [0.3, -0.8]
            .map(|tilt| {
                let mut camera = scene.seen_from(&(normal + side * tilt));
                let forward = camera.rotation() * Vector3::z();
                camera = camera.perturbed(&(-forward * 1.5), &Vector3::zeros());
                scene.see(&camera, 1.0)
            })
            .into();
        if seen.iter().all(|seen| seen.modes.len() < 2 || seen.modes[1].weight < 0.05) {
            continue;
        }
        ambiguous += 1;
        let solution = scene.solve(&seen);
        settled += u32::from(solution.status == Status::Ok);
        let right = solution.world_from_points.angle_to(&scene.world_from_points).to_degrees() < 12.0;
        wrong += u32::from(!right && solution.status == Status::Ok);
    }
    println!("{settled} of {ambiguous} settled, {wrong} of them wrong");
    assert!(ambiguous > 60 && f64::from(settled) > 0.8 * f64::from(ambiguous), "{settled} of {ambiguous}");
    assert!(f64::from(wrong) < 0.02 * f64::from(ambiguous), "{wrong} of {ambiguous}");
}

/// Understated noise shows in the residuals of all views together, and widens the covariance.
#[test]
fn understated_noise_is_found_out() {
    let mut values = Vec::new();
    for problem in 0..300 {
        let mut scene = Scene::new(26, problem);
        let seen: Vec<_> = (0..3)
            .map(|_| {
                let camera = scene.around();
                let mut seen = scene.see(&camera, 0.0);
                let reading = &mut seen.readings[0];
                for pixel in &mut reading.pixels {
                    *pixel += Vector2::new(scene.normal(), scene.normal()).normalize() * 1.8;
                }
                reading.covariances_px = vec![Matrix2::identity(); reading.pixels.len()];
                seen.modes = scene.solve_reading(&seen);
                seen
            })
            .collect();
        let solution = scene.solve(&seen);
        values.push(nees(&scene.world_from_points, &solution.world_from_points, &solution.covariance));
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    assert!((4.5..8.0).contains(&mean), "{mean}");
}

/// Where a covariance is known to be larger along some directions and smaller along others, only what is larger is shared.
#[test]
fn what_is_shared_is_no_less_than_nothing() {
    for problem in 0..200 {
        let mut scene = Scene::new(27, problem);
        let camera = scene.around();
        let seen = scene.see(&camera, 1.0);
        let own = seen.modes[0];
        let factors = Covariance6::from_diagonal(&nalgebra::Vector6::from_fn(|_, _| scene.normal().exp()));
        let known = own.with_covariance(&(factors * own.covariance * factors));
        // Neither the shared part nor what the points say alone is lost along any direction.
        let root = own.covariance.cholesky().unwrap().l().try_inverse().unwrap();
        let eigenvalues = |covariance: Covariance6| (root * covariance * root.transpose()).symmetric_eigenvalues();
        assert!(eigenvalues(known.shared).min() > -1e-6, "{problem}");
        assert!(eigenvalues(own.covariance + known.shared - known.covariance).min() > -1e-6, "{problem}");
        assert!(eigenvalues(known.shared).max() > 0.1 || eigenvalues(known.covariance).max() < 1.1, "{problem}");
        // As much as it says: nothing beyond.
        assert!(own.with_covariance(&own.covariance).shared.amax() < 1e-9 * own.covariance.amax(), "{problem}");
    }
}
