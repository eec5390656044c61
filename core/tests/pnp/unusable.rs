//! Input that no pose follows from.

use nalgebra::{Matrix2, Vector2, Vector3};
use posed_core::geometry::{Camera, Pose, ProjectionError};
use posed_core::pnp::{PnpError, solve};
use rand::RngExt as _;

use crate::scene::{Scene, cube, exact};

fn attempt(
    camera: &Camera,
    points: &[Vector3<f64>],
    pixels: &[Vector2<f64>],
    covariances: &[Matrix2<f64>],
) -> Result<Pose, PnpError> {
    solve(points, pixels, covariances, camera, &exact()).map(|solution| solution.pose)
}

#[test]
fn unusable_input_is_named() {
    let scene = Scene::new(60, 0);
    let (camera, points, unit) = (&scene.camera, cube(0.08), [Matrix2::identity(); 8]);
    let pixels = scene.project(&points);
    assert_eq!(attempt(camera, &points[..3], &pixels[..3], &unit[..3]), Err(PnpError::PointCount { given: 3 }));
    assert_eq!(attempt(camera, &[], &[], &[]), Err(PnpError::PointCount { given: 0 }));
    let many = vec![Vector3::zeros(); 17];
    let rest = (vec![Vector2::zeros(); 17], vec![Matrix2::identity(); 17]);
    assert_eq!(attempt(camera, &many, &rest.0, &rest.1), Err(PnpError::PointCount { given: 17 }));
    let lengths = PnpError::Lengths { points: 8, pixels: 7, covariances: 8 };
    assert_eq!(attempt(camera, &points, &pixels[..7], &unit), Err(lengths));
    for value in [f64::NAN, f64::INFINITY] {
        let mut broken = pixels.clone();
        broken[2].x = value;
        assert_eq!(attempt(camera, &points, &broken, &unit), Err(PnpError::NotFinite { index: 2 }));
        let mut broken = points.clone();
        broken[7].z = value;
        assert_eq!(attempt(camera, &broken, &pixels, &unit), Err(PnpError::NotFinite { index: 7 }));
    }
    for covariance in
        [Matrix2::new(1.0, 1.0, 1.0, 1.0), Matrix2::zeros(), -Matrix2::identity(), Matrix2::new(1.0, 2.0, 2.0, 1.0)]
    {
        let mut flat = unit;
        flat[5] = covariance;
        assert_eq!(attempt(camera, &points, &pixels, &flat), Err(PnpError::Covariance { index: 5 }));
    }
}

#[test]
fn points_without_extent_are_refused() {
    let scene = Scene::new(61, 0);
    let pixels = scene.project(&cube(0.08));
    let unit = [Matrix2::identity(); 8];
    let line: Vec<_> = (0..8).map(|k| Vector3::new(0.01, 0.02, -0.01) * f64::from(k)).collect();
    assert_eq!(attempt(&scene.camera, &line, &pixels, &unit), Err(PnpError::Degenerate));
    assert_eq!(attempt(&scene.camera, &[Vector3::repeat(0.3); 8], &pixels, &unit), Err(PnpError::Degenerate));
}

/// One is left out, and said to be; too many are an error.
#[test]
fn pixels_outside_the_lens_take_no_part() {
    let scene = Scene::new(62, 0);
    let points = cube(0.08);
    let folded = scene.camera.clone().with_opencv_distortion(&[-0.3, 0.0, 0.0, 0.0]).unwrap();
    let right: Vec<_> = points.iter().map(|point| folded.project(&scene.pose.transform(point)).unwrap()).collect();
    let mut pixels = right.clone();
    for outside in [4, 0, 7] {
        pixels[outside] = Vector2::new(2000.0, 200.0);
        let solution = solve(&points, &pixels, &[Matrix2::identity(); 8], &folded, &exact()).unwrap();
        assert!(scene.error_deg(&solution.pose) < 1e-3);
        for (index, residual) in solution.residuals().iter().enumerate() {
            let left_out = pixels[index] != right[index];
            assert_eq!((residual.outside_lens, residual.inlier), (left_out, !left_out));
            assert_eq!(residual.error_px.norm() < 1e-3, !left_out);
        }
        assert!(solution.rmse_px() < 1e-3);
    }
    for outside in [1, 2] {
        pixels[outside] = Vector2::new(2000.0, 200.0);
    }
    let error = PnpError::Pixel { index: 0, source: ProjectionError::OutsideLens };
    assert_eq!(attempt(&folded, &points, &pixels, &[Matrix2::identity(); 8]), Err(error));
}

/// Six points that agree are enough of eight, and not of fourteen.
#[test]
fn few_inliers_are_also_a_small_share() {
    let scene = Scene::new(64, 0);
    let mut points = cube(0.08);
    points.extend((0..6).map(|k| Vector3::ith(k / 2, if k % 2 == 0 { 0.07 } else { -0.07 })));
    let mut pixels = scene.project(&points);
    for (wrong, pixel) in pixels.iter_mut().enumerate().skip(6) {
        *pixel += Vector2::new(40.0 * if wrong % 2 == 0 { 1.0 } else { -1.0 }, 9.0 * wrong as f64);
    }
    for (given, few) in [(8, false), (12, false), (13, true), (14, true)] {
        let unit = vec![Matrix2::identity(); given];
        let solution = solve(&points[..given], &pixels[..given], &unit, &scene.camera, &exact()).unwrap();
        assert_eq!((solution.inlier_count(), solution.doubts.few_inliers), (6, few), "of {given}");
    }
}

/// Pixels without any relation to the points, huge and tiny ones too: an error or a finite pose in front of the camera.
#[test]
fn nonsense_gives_no_nonsense() {
    let mut solved = 0;
    for problem in 0..3000 {
        let mut scene = Scene::new(63, problem);
        let count = scene.rng.random_range(4..=16);
        let scale = 10.0_f64.powf(scene.rng.random_range(-3.0..4.0));
        let points: Vec<_> = scene.points_in_shell(count).iter().map(|p| p * scale).collect();
        let reach = 10.0_f64.powf(scene.rng.random_range(-2.0..5.0));
        let pixels: Vec<_> =
            (0..count).map(|_| Vector2::from_fn(|_, _| scene.rng.random_range(-reach..reach))).collect();
        let covariance = Matrix2::identity() * 10.0_f64.powf(scene.rng.random_range(-6.0..6.0));
        if let Ok(solution) = solve(&points, &pixels, &vec![covariance; count], &scene.camera, &exact()) {
            solved += 1;
            let numbers = solution.pose.matrix();
            assert!(numbers.iter().chain(solution.covariance.iter()).all(|v| v.is_finite()));
            assert!(points.iter().all(|point| solution.pose.transform(point).z > 0.0));
            assert!(solution.weight.is_finite() && solution.rmse_px().is_finite());
            let gram = solution.pose.rotation().matrix().transpose() * solution.pose.rotation().matrix();
            assert!((gram - nalgebra::Matrix3::identity()).norm() < 1e-9);
        }
    }
    assert!(solved > 1000, "only {solved} of 3000 solved at all");
}
