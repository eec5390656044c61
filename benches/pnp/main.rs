//! Time of one robust pose solve, with covariance and alternatives.
#![allow(clippy::expect_used, reason = "a bench fails by panicking")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
use posed::geometry::{Camera, Pose};
use posed::pnp::{Options, solve};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng};

fn solve_bench(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("pnp");
    for (count, outliers) in [(4, 0), (6, 0), (8, 0), (8, 2), (12, 0)] {
        let mut rng = SmallRng::seed_from_u64(count as u64);
        let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).expect("a camera");
        let pose = Pose::new(Rotation3::new(Vector3::new(0.4, -0.8, 0.3)), Vector3::new(0.05, 0.02, 0.7));
        let points: Vec<Vector3<f64>> =
            (0..count).map(|_| Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0f64)).normalize() * 0.08).collect();
        let pixels: Vec<Vector2<f64>> = points
            .iter()
            .enumerate()
            .map(|(index, point)| {
                let noise = if index < outliers { 60.0 } else { 1.5 };
                let pixel = camera.project(&pose.transform(point)).expect("in front of the camera");
                pixel + Vector2::from_fn(|_, _| rng.random_range(-noise..noise))
            })
            .collect();
        let covariances = vec![Matrix2::identity(); count];
        let options = Options::default();
        group.bench_function(BenchmarkId::new(format!("{count} points"), format!("{outliers} outliers")), |bencher| {
            bencher.iter(|| solve(black_box(&points), black_box(&pixels), &covariances, &camera, &options));
        });
    }
    group.finish();
}

criterion_group!(benches, solve_bench);
criterion_main!(benches);
