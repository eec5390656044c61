//! Time of the numerical core: pose solves with covariance and alternatives, calibration, cameras.
//!
//! With `POSED_PROBLEMS` naming a file, solves its problems instead, once each and in turn, for
//! `benches/compare/pnp.py`.
#![allow(clippy::expect_used, reason = "a bench fails by panicking")]

mod problems;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion};
use nalgebra::{Matrix2, Matrix6, Rotation3, Vector2, Vector3};
use posed_core::calibration::{Consensus, Mode, Offset, average};
use posed_core::geometry::{Camera, Pose};
use posed_core::pnp::{Options, solve};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

/// Problems that one timing goes through, so that no branch predictor learns a single one.
const PROBLEMS: usize = 64;

struct Problem {
    points: Vec<Vector3<f64>>,
    pixels: Vec<Vector2<f64>>,
}

fn pinhole() -> Camera {
    Camera::pinhole(600.0, 600.0, 319.5, 239.5).expect("a camera")
}

fn random_problem(rng: &mut SmallRng, count: usize, flatness: f64, outliers: usize) -> Problem {
    let mut unit = || rng.random_range(-1.0..1.0f64);
    let turn = Vector3::new(unit(), unit(), unit()) * 2.0;
    let pose = Pose::new(Rotation3::new(turn), Vector3::new(0.1 * unit(), 0.1 * unit(), 0.8 + 0.2 * unit()));
    let points: Vec<_> =
        (0..count).map(|_| Vector3::new(unit(), unit(), flatness * unit()).normalize() * 0.08).collect();
    let pixels = points
        .iter()
        .enumerate()
        .map(|(index, point)| {
            // Sums of uniform numbers: standard deviation 1 px, but for the outliers.
            let noise = if index < outliers { 60.0 } else { 1.0 };
            let mut error = || noise * (unit() + unit() + unit());
            pinhole().project(&pose.transform(point)).expect("in front of the camera") + Vector2::new(error(), error())
        })
        .collect();
    Problem { points, pixels }
}

fn solving(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pnp");
    let sets = [("general", 4, 1.0, 0), ("general", 6, 1.0, 0), ("general", 8, 1.0, 0), ("general", 12, 1.0, 0)];
    for (shape, count, flatness, outliers) in sets.into_iter().chain([("planar", 8, 0.0, 0), ("2 outliers", 8, 1.0, 2)])
    {
        let mut rng = SmallRng::seed_from_u64(count as u64);
        let problems: Vec<_> = (0..PROBLEMS).map(|_| random_problem(&mut rng, count, flatness, outliers)).collect();
        let covariances = vec![Matrix2::identity(); count];
        let (camera, options) = (pinhole(), Options::default());
        let mut next = 0;
        group.bench_function(BenchmarkId::new(format!("{count} points"), shape), |bencher| {
            bencher.iter(|| {
                next = (next + 1) % PROBLEMS;
                let Problem { points, pixels } = black_box(&problems[next]);
                solve(points, pixels, &covariances, &camera, &options)
            });
        });
    }
    group.finish();
}

fn calibrating(criterion: &mut Criterion) {
    let mut rng = SmallRng::seed_from_u64(1);
    let mut small = || rng.random_range(-0.01..0.01f64);
    let references: Vec<_> = (0..10)
        .map(|_| Offset {
            object_from_keypoints: Pose::identity()
                .perturbed(&Vector3::new(small(), small(), small()), &Vector3::new(small(), small(), small())),
            covariance: Matrix6::identity() * 1e-4,
            keypoints_scale: 1.0,
        })
        .collect();
    for mode in [Mode::Paper, Mode::Weighted] {
        criterion.bench_function(&format!("calibrate/10 references, {mode:?}"), |bencher| {
            bencher.iter(|| average(black_box(&references), mode, &Consensus::default()));
        });
    }
}

fn unprojecting(criterion: &mut Criterion) {
    let lens = |coefficients: &[f64]| pinhole().with_opencv_distortion(coefficients).expect("coefficients");
    let cameras = [
        ("pinhole", pinhole()),
        ("opencv 5", lens(&[-0.28, 0.09, 0.0011, -0.0007, -0.013])),
        (
            "opencv 12",
            lens(&[-0.21, 0.07, 0.0009, 0.0004, -0.01, 0.02, 0.003, -0.001, 0.0011, -0.0004, -0.0008, 0.0002]),
        ),
        ("fisheye", pinhole().with_fisheye_distortion(&[-0.021, 0.0083, -0.0041, 0.0007]).expect("coefficients")),
    ];
    for (name, camera) in cameras {
        let mut column = 0.0;
        criterion.bench_function(&format!("unproject/{name}"), |bencher| {
            bencher.iter(|| {
                column = (column + 37.0) % 640.0;
                camera.unproject_with_jacobian(&black_box(Vector2::new(column, 100.0)))
            });
        });
    }
}

fn main() {
    if let Some(path) = std::env::var_os("POSED_PROBLEMS") {
        problems::solve_file(path.as_ref());
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    solving(&mut criterion);
    calibrating(&mut criterion);
    unprojecting(&mut criterion);
    criterion.final_summary();
}
