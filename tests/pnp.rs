//! Behaviour of the PnP solver on many seeded problems, through its public interface.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
use posed::geometry::{Camera, Pose};
use posed::pnp::{Options, PnpError, Reason, Status, solve};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng};
use rand_distr::{Distribution as _, StandardNormal};

/// A camera and an object half a metre away; the generator of everything random about it.
struct Scene {
    rng: SmallRng,
    camera: Camera,
    pose: Pose,
}

impl Scene {
    /// Each problem of a test has its own seed, so that problems do not depend on their order.
    fn new(test: u64, problem: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(test << 32 | problem);
        let axis = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let rotation = Rotation3::new(axis.normalize() * rng.random_range(0.0..std::f64::consts::PI));
        let [x, y] = [rng.random_range(-0.15..0.15), rng.random_range(-0.1..0.1)];
        let pose = Pose::new(rotation, Vector3::new(x, y, rng.random_range(0.5..1.0)));
        Self { rng, camera: Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap(), pose }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    fn points_in_ball(&mut self, count: usize) -> Vec<Vector3<f64>> {
        (0..count)
            .map(|_| {
                let direction = Vector3::from_fn(|_, _| self.normal()).normalize();
                direction * self.rng.random_range(0.05..0.1)
            })
            .collect()
    }

    fn project(&self, points: &[Vector3<f64>]) -> Vec<Vector2<f64>> {
        points.iter().map(|point| self.camera.project(&self.pose.transform(point)).unwrap()).collect()
    }

    /// A random covariance with standard deviations of 0.5 to 3 px, and an error drawn from it.
    fn noise(&mut self) -> (Matrix2<f64>, Vector2<f64>) {
        let (long, short) = (self.rng.random_range(0.5..3.0), self.rng.random_range(0.5..1.5));
        let turn = nalgebra::Rotation2::new(self.rng.random_range(0.0..3.0));
        let root = turn.matrix() * Matrix2::from_diagonal(&Vector2::new(long, short));
        (root * root.transpose(), root * Vector2::from_fn(|_, _| self.normal()))
    }
}

fn cube(radius: f64) -> Vec<Vector3<f64>> {
    let side = radius / 3.0_f64.sqrt();
    (0..8).map(|k| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { side } else { -side })).collect()
}

fn degrees_apart(a: &Pose, b: &Pose) -> f64 {
    a.angle_to(b).to_degrees()
}

/// No floor: these tests state the noise exactly.
fn exact() -> Options {
    Options { floor_px: 0.0, ..Options::default() }
}

#[test]
fn recovers_the_pose_without_noise() {
    for count in 4..=12 {
        for problem in 0..100 {
            let mut scene = Scene::new(1, problem);
            let points = scene.points_in_ball(count);
            let pixels = scene.project(&points);
            let solution = solve(&points, &pixels, &vec![Matrix2::identity(); count], &scene.camera, &exact()).unwrap();
            let best = std::iter::once(solution.pose).chain(solution.alternatives.iter().flatten().map(|a| a.pose));
            let apart = best.map(|pose| degrees_apart(&pose, &scene.pose)).fold(f64::INFINITY, f64::min);
            assert!(apart < 1e-3, "{count} points, problem {problem}: {apart} deg");
        }
    }
}

#[test]
fn covariance_is_true() {
    let (mut nees, mut inside) = (Vec::new(), 0);
    let problems: usize = 2000;
    for problem in 0..problems {
        let mut scene = Scene::new(2, problem as u64);
        let points = cube(0.08);
        let (covariances, errors): (Vec<_>, Vec<_>) = (0..8).map(|_| scene.noise()).unzip();
        let pixels: Vec<_> = scene.project(&points).iter().zip(&errors).map(|(p, e)| p + e).collect();
        let solution = solve(&points, &pixels, &covariances, &scene.camera, &exact()).unwrap();
        let translation = scene.pose.translation() - solution.pose.translation();
        let rotation = (scene.pose.rotation() * solution.pose.rotation().inverse()).scaled_axis();
        let error = nalgebra::Vector6::from_iterator(translation.iter().chain(rotation.iter()).copied());
        let squared = (error.transpose() * solution.covariance.try_inverse().unwrap() * error)[0];
        nees.push(squared);
        inside += usize::from(squared < 12.592); // 95 % of chi-squared with 6 degrees of freedom
    }
    nees.sort_by(f64::total_cmp);
    // A chi-squared variable of 6 degrees has median 5.35. Inflation by chi2/dof makes the answer a little cautious.
    let median = nees[nees.len() / 2];
    assert!((4.3..5.8).contains(&median), "median NEES {median}");
    let coverage = inside as f64 / problems as f64;
    assert!((0.93..0.995).contains(&coverage), "coverage {coverage}");
}

#[test]
fn survives_two_gross_outliers_of_eight() {
    let (mut wrong, mut accepted_wrong) = (0, 0);
    let problems: usize = 1000;
    for problem in 0..problems {
        let mut scene = Scene::new(3, problem as u64);
        let points = cube(0.08);
        let mut pixels = scene.project(&points);
        for pixel in &mut pixels {
            *pixel += Vector2::new(scene.normal(), scene.normal());
        }
        for _ in 0..2 {
            let victim = scene.rng.random_range(0..8);
            let centre = scene.camera.project(scene.pose.translation()).unwrap();
            pixels[victim] = centre + Vector2::from_fn(|_, _| scene.rng.random_range(-75.0..75.0));
        }
        let options = exact();
        let solution = solve(&points, &pixels, &[Matrix2::identity(); 8], &scene.camera, &options).unwrap();
        if degrees_apart(&solution.pose, &scene.pose) > 10.0 {
            wrong += 1;
            accepted_wrong += usize::from(solution.judge(&options).0 == Status::Ok);
        }
    }
    assert!(wrong <= problems / 100, "{wrong} of {problems} wrong");
    assert!(accepted_wrong <= problems / 500, "{accepted_wrong} of {problems} wrong and called ok");
}

#[test]
fn a_distant_flat_object_is_called_ambiguous() {
    let mut unflagged = 0;
    let mut flagged = 0;
    for problem in 0..200 {
        let mut scene = Scene::new(4, problem);
        let points: Vec<_> = scene.points_in_ball(8).into_iter().map(|p| Vector3::new(p.x, p.y, 0.0)).collect();
        scene.pose = Pose::new(*scene.pose.rotation(), scene.pose.translation() * 4.0);
        let mut pixels = scene.project(&points);
        for pixel in &mut pixels {
            *pixel += Vector2::new(scene.normal(), scene.normal()) * 0.5;
        }
        let options = exact();
        let Ok(solution) = solve(&points, &pixels, &[Matrix2::identity() * 0.25; 8], &scene.camera, &options) else {
            continue;
        };
        let (status, reasons) = solution.judge(&options);
        flagged += usize::from(reasons.contains(&Reason::PlanarAmbiguity));
        let wrong = degrees_apart(&solution.pose, &scene.pose) > 20.0;
        unflagged += usize::from(wrong && status == Status::Ok);
    }
    assert!(flagged > 50, "only {flagged} of 200 flagged");
    assert!(unflagged <= 6, "{unflagged} of 200 wrong and called ok");
}

#[test]
fn same_input_same_bits() {
    let mut scene = Scene::new(5, 0);
    let points = cube(0.08);
    let pixels: Vec<_> =
        scene.project(&points).iter().map(|p| p + Vector2::new(scene.normal(), scene.normal())).collect();
    let run = || solve(&points, &pixels, &[Matrix2::identity(); 8], &scene.camera, &Options::default()).unwrap();
    assert_eq!(run().pose, run().pose);
    assert_eq!(run().covariance, run().covariance);
}

#[test]
fn unusable_input_is_named() {
    let scene = Scene::new(6, 0);
    let points = cube(0.08);
    let pixels = scene.project(&points);
    let unit = [Matrix2::identity(); 8];
    let attempt = |points: &[Vector3<f64>], pixels: &[Vector2<f64>], covariances: &[Matrix2<f64>]| {
        solve(points, pixels, covariances, &scene.camera, &exact()).map(|solution| solution.pose)
    };
    assert_eq!(attempt(&points[..3], &pixels[..3], &unit[..3]), Err(PnpError::PointCount { given: 3 }));
    assert_eq!(attempt(&points, &pixels[..7], &unit), Err(PnpError::Lengths { points: 8, pixels: 7, covariances: 8 }));
    let mut broken = pixels.clone();
    broken[2].x = f64::NAN;
    assert_eq!(attempt(&points, &broken, &unit), Err(PnpError::NotFinite { index: 2 }));
    let mut flat = unit;
    flat[5] = Matrix2::new(1.0, 1.0, 1.0, 1.0);
    assert_eq!(attempt(&points, &pixels, &flat), Err(PnpError::Covariance { index: 5 }));
    let line: Vec<_> = (0..8).map(|k| Vector3::new(0.01 * f64::from(k), 0.0, 0.0)).collect();
    assert_eq!(attempt(&line, &pixels, &unit), Err(PnpError::Degenerate));
    assert_eq!(attempt(&[Vector3::zeros(); 8], &pixels, &unit), Err(PnpError::Degenerate));
}

#[test]
fn no_pose_is_ever_not_finite_or_behind_the_camera() {
    for problem in 0..500 {
        let mut scene = Scene::new(7, problem);
        let count = scene.rng.random_range(4..=12);
        let points = scene.points_in_ball(count);
        // Pixels without any relation to the points.
        let pixels: Vec<_> =
            (0..count).map(|_| Vector2::from_fn(|_, _| scene.rng.random_range(-100.0..800.0))).collect();
        if let Ok(solution) = solve(&points, &pixels, &vec![Matrix2::identity(); count], &scene.camera, &exact()) {
            assert!(solution.pose.matrix().iter().chain(solution.covariance.iter()).all(|v| v.is_finite()));
            assert!(points.iter().all(|point| solution.pose.transform(point).z > 0.0));
        }
    }
}
