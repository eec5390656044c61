//! The offset from several references, and the reference pose from clicked points.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
use posed_core::calibration::{
    AverageError, Click, ClickError, ClickedPair, Consensus, FrameClicks, Mode, Offset, average, reference_from_clicks,
};
use posed_core::geometry::{Camera, Pose, Symmetries, TriangulationError};
use posed_core::pnp::{self, solve};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};

const MODES: [Mode; 2] = [Mode::Paper, Mode::Weighted];

fn camera() -> Camera {
    Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap()
}

fn normal(rng: &mut SmallRng) -> f64 {
    StandardNormal.sample(rng)
}

fn direction(rng: &mut SmallRng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng)).normalize()
}

/// Where the keypoints lie in the object.
fn true_offset() -> Pose {
    Pose::new(Rotation3::new(Vector3::new(0.3, -1.2, 0.8)), Vector3::new(0.01, -0.02, 0.005))
}

/// Offsets measured on images from all sides, each by PnP of eight keypoints with 1 px of noise.
fn references(seed: u64, count: usize) -> Vec<Offset> {
    let mut rng = SmallRng::seed_from_u64(seed);
    let side = 0.08 / 3.0_f64.sqrt();
    let keypoints: Vec<_> =
        (0..8).map(|k| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { side } else { -side })).collect();
    (0..count)
        .map(|_| {
            let turn = direction(&mut rng) * rng.random_range(0.0..3.1);
            let place = Vector3::new(rng.random_range(-0.1..0.1), rng.random_range(-0.1..0.1), 0.7);
            let camera_from_object = Pose::new(Rotation3::new(turn), place);
            let camera_from_keypoints = camera_from_object * true_offset();
            let pixels: Vec<_> = keypoints
                .iter()
                .map(|point| {
                    let pixel = camera().project(&camera_from_keypoints.transform(point)).unwrap();
                    pixel + Vector2::new(normal(&mut rng), normal(&mut rng))
                })
                .collect();
            let options = pnp::Options { floor_px: 0.0, ..pnp::Options::default() };
            let solution = solve(&keypoints, &pixels, &[Matrix2::identity(); 8], &camera(), &options).unwrap();
            Offset::measure(&camera_from_object, &solution.pose, &solution.covariance)
        })
        .collect()
}

/// In every image the network may see the object turned by one of its symmetries: the references still agree.
#[test]
fn references_of_a_symmetric_object_agree() {
    // About an axis along z through (2, 0, 0) mm.
    let half_turn = Pose::new(Rotation3::new(Vector3::z() * std::f64::consts::PI), Vector3::x() * 0.004);
    let symmetries = Symmetries::new(&[half_turn], Vec::new()).unwrap();
    let turned: Vec<Offset> = references(11, 8)
        .into_iter()
        .enumerate()
        .map(|(index, offset)| Offset {
            object_from_keypoints: if index % 3 == 1 {
                half_turn * offset.object_from_keypoints
            } else {
                offset.object_from_keypoints
            },
            ..offset
        })
        .collect();
    let plain = average(&turned, Mode::Weighted, &Consensus::default()).unwrap();
    assert!(plain.residuals.iter().any(|residual| !residual.inlier), "the test turns some references away");
    let alike: Vec<Offset> = turned.iter().map(|offset| offset.nearest(&symmetries, &turned[0])).collect();
    let averaged = average(&alike, Mode::Weighted, &Consensus::default()).unwrap();
    assert!(averaged.residuals.iter().all(|residual| residual.inlier));
    assert!(error_m(&averaged.offset) < 1e-3, "{}", error_m(&averaged.offset));
}

fn error_m(offset: &Offset) -> f64 {
    (offset.object_from_keypoints.translation() - true_offset().translation()).norm()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn weighting_by_covariance_beats_the_plain_mean() {
    let mut errors = [Vec::new(), Vec::new()];
    for seed in 0..200 {
        let references = references(seed, 10);
        for (errors, mode) in errors.iter_mut().zip(MODES) {
            errors.push(error_m(&average(&references, mode, &Consensus::default()).unwrap().offset));
        }
    }
    let [paper, weighted] = errors.map(median);
    println!("median error of ten references: paper {:.2} mm, weighted {:.2} mm", 1e3 * paper, 1e3 * weighted);
    assert!(weighted <= 0.25 * paper, "{weighted} {paper}");
}

#[test]
fn covariance_of_the_offset_is_true() {
    for mode in MODES {
        let problems = 500;
        let mut nees = Vec::new();
        for seed in 0..problems {
            let offset = average(&references(1000 + seed, 5), mode, &Consensus::default()).unwrap().offset;
            let error = offset.object_from_keypoints.step_to(&true_offset());
            nees.push(error.dot(&(offset.covariance.cholesky().unwrap().inverse() * error)));
        }
        // Chi-squared with 6 degrees of freedom has median 5.35; caution about scatter makes it a little less.
        let median = median(nees);
        assert!((4.2..6.2).contains(&median), "{mode:?}: {median}");
    }
}

#[test]
fn wrong_references_are_left_out() {
    for seed in 0..100 {
        let mut rng = SmallRng::seed_from_u64(seed);
        let mut all = references(seed, 10);
        let wrong = [0, 4, 9];
        for index in wrong {
            let stray = direction(&mut rng) * rng.random_range(0.5..3.0);
            let aside = direction(&mut rng) * rng.random_range(0.05..0.2);
            all[index].object_from_keypoints = all[index].object_from_keypoints.perturbed(&aside, &stray);
        }
        for mode in MODES {
            let averaged = average(&all, mode, &Consensus::default()).unwrap();
            assert!(averaged.offset.object_from_keypoints.angle_to(&true_offset()).to_degrees() < 2.0);
            assert!(error_m(&averaged.offset) < 0.01, "{mode:?}");
            for (index, residual) in averaged.residuals.iter().enumerate() {
                assert_eq!(residual.inlier, !wrong.contains(&index), "{mode:?} reference {index}");
                assert_eq!(residual.rotation_rad > 0.3, wrong.contains(&index));
            }
        }
    }
}

#[test]
fn one_reference_is_its_own_mean_and_a_seed_decides_all() {
    let all = references(7, 6);
    for mode in MODES {
        let single = average(&all[..1], mode, &Consensus::default()).unwrap();
        let apart = single.offset.object_from_keypoints.step_to(&all[0].object_from_keypoints);
        assert!(apart.norm() < 1e-12 && (single.offset.covariance - all[0].covariance).norm() < 1e-12);
        let run = || average(&all, mode, &Consensus { seed: 3, ..Consensus::default() }).unwrap().offset;
        assert_eq!(run().object_from_keypoints, run().object_from_keypoints);
    }
}

#[test]
fn unusable_references_are_named() {
    let good = references(8, 3);
    for mode in MODES {
        let attempt = |references: &[Offset]| average(references, mode, &Consensus::default()).map(|_| ());
        assert_eq!(attempt(&[]), Err(AverageError::Empty));
        let mut broken = good.clone();
        broken[1].covariance[(2, 2)] = f64::NAN;
        assert_eq!(attempt(&broken), Err(AverageError::NotFinite { index: 1 }));
        broken[1].covariance[(2, 2)] = -1.0;
        assert_eq!(attempt(&broken), Err(AverageError::Covariance { index: 1 }));
        let mut scattered = good.clone();
        for (index, reference) in scattered.iter_mut().enumerate() {
            let turn = Vector3::z() * index as f64;
            reference.object_from_keypoints = reference.object_from_keypoints.perturbed(&Vector3::zeros(), &turn);
        }
        assert!(matches!(attempt(&scattered), Err(AverageError::NoConsensus { agreeing: 1, references: 3, .. })));
    }
}

/// Six points of an object in its own frame: origin, one on x, one in the xy plane, and others.
const CLICKED: [[f64; 3]; 6] =
    [[0.0, 0.0, 0.0], [0.08, 0.0, 0.0], [0.03, 0.06, 0.0], [0.0, 0.0, 0.05], [0.07, 0.05, 0.02], [0.02, 0.05, 0.04]];
const FRAME: FrameClicks = FrameClicks { origin: 0, on_x: 1, in_xy: 2 };

/// Two views of the clicked points: the first's pose, the relative pose and the clicks, with noise.
fn clicked(seed: u64, sigma_px: f64) -> (Pose, Pose, Vec<Click>) {
    let mut rng = SmallRng::seed_from_u64(seed);
    let turn = direction(&mut rng) * rng.random_range(0.0..3.1);
    let first = Pose::new(Rotation3::new(turn), Vector3::new(0.02, -0.03, 0.5));
    // The second camera has gone 30 degrees around the object.
    let second = Pose::new(Rotation3::new(Vector3::y() * 0.5) * first.rotation(), Vector3::new(-0.01, 0.02, 0.55));
    let mut pixel = |pose: &Pose, point: [f64; 3]| {
        let exact = camera().project(&pose.transform(&point.into())).unwrap();
        exact + Vector2::new(normal(&mut rng), normal(&mut rng)) * sigma_px
    };
    let clicks = CLICKED.iter().map(|p| Click { first_px: pixel(&first, *p), second_px: pixel(&second, *p) }).collect();
    (first, second * first.inverse(), clicks)
}

fn from_clicks(
    clicks: &[Click],
    second_from_first: Pose,
    frame: FrameClicks,
) -> Result<posed_core::calibration::ClickedReference, ClickError> {
    let camera = camera();
    let pair = ClickedPair { first_camera: &camera, second_camera: &camera, second_from_first, clicks, sigma_px: 1.0 };
    reference_from_clicks(&pair, frame)
}

#[test]
fn clicks_give_the_reference_pose() {
    let (mut angles, mut shifts) = (Vec::new(), Vec::new());
    for seed in 0..200 {
        let (truth, relative, clicks) = clicked(seed, 0.0);
        let found = from_clicks(&clicks, relative, FRAME).unwrap();
        assert!(found.camera_from_object.angle_to(&truth) < 1e-6);
        for (found, point) in found.points_in_object.iter().zip(CLICKED) {
            assert!((found - Vector3::from(point)).norm() < 1e-6);
        }
        assert!(found.residuals.iter().all(|r| r.first_px.max(r.second_px) < 1e-6 && r.ray_mm < 1e-6));
        let (truth, relative, clicks) = clicked(seed, 1.0);
        let found = from_clicks(&clicks, relative, FRAME).unwrap();
        angles.push(found.camera_from_object.angle_to(&truth).to_degrees());
        shifts.push((found.camera_from_object.translation() - truth.translation()).norm());
        assert!(found.residuals.iter().any(|r| r.first_px > 0.05 && r.ray_mm > 0.01 && r.sigma_mm > 0.5));
    }
    let (angle, shift) = (median(angles), median(shifts));
    assert!(angle < 4.0 && shift < 0.01, "{angle} deg, {shift} m");
}

#[test]
fn unusable_clicks_are_named() {
    let (_, relative, clicks) = clicked(1, 0.0);
    let attempt = |clicks: &[Click], relative, frame| from_clicks(clicks, relative, frame).map(|_| ());
    assert_eq!(attempt(&clicks[..3], relative, FRAME), Err(ClickError::Count(3)));
    let outside = FrameClicks { in_xy: 6, ..FRAME };
    assert_eq!(attempt(&clicks, relative, outside), Err(ClickError::FrameIndex { index: 6, clicks: 6 }));
    let twice = FrameClicks { in_xy: 1, ..FRAME };
    assert_eq!(attempt(&clicks, relative, twice), Err(ClickError::DegenerateFrame));
    let shifted = |by: f64| -> Vec<Click> {
        let moved = |c: &Click| Click { second_px: c.first_px + Vector2::new(by, 0.0), ..*c };
        clicks.iter().map(moved).collect()
    };
    // One image twice, whatever pose is stated for it; and rays that nowhere meet.
    assert_eq!(attempt(&shifted(1.0), relative, FRAME), Err(ClickError::SameImage));
    assert!(matches!(attempt(&shifted(9.0), Pose::identity(), FRAME), Err(ClickError::Triangulation { index: 0, .. })));
    let mut broken = clicks.clone();
    broken[2].second_px.y = f64::NAN;
    let not_finite = ClickError::Triangulation { index: 2, source: TriangulationError::NotFinite { index: 1 } };
    assert_eq!(attempt(&broken, relative, FRAME), Err(not_finite));
    // The relative pose the wrong way round, and a click on the wrong corner.
    assert!(matches!(attempt(&clicks, relative.inverse(), FRAME), Err(ClickError::RaysMiss { .. })));
    let mut swapped = clicks.clone();
    swapped[3].second_px = clicks[4].second_px;
    let outlier = attempt(&swapped, relative, FRAME);
    assert!(
        matches!(outlier, Err(ClickError::Outlier { index: 3, error_px, others_px }) if error_px > 10.0 && others_px < 1.0)
    );
    // Among clicks that are all inexact it is a wrong one that stands out, and not the worst of the right ones.
    let (mut named, mut innocent) = (0, 0);
    for seed in 0..50 {
        let (_, relative, mut clicks) = clicked(seed, 1.0);
        innocent += usize::from(from_clicks(&clicks, relative, FRAME).is_ok());
        let normal = Vector2::new(0.0, 25.0);
        clicks[4].first_px += normal;
        named +=
            usize::from(matches!(from_clicks(&clicks, relative, FRAME), Err(ClickError::Outlier { index: 4, .. })));
    }
    assert!(named >= 45 && innocent == 50, "{named} named, {innocent} of 50 accepted");
}
