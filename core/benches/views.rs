//! Time of a pose from several views, without the views' own poses.
#![allow(clippy::expect_used, reason = "a bench fails by panicking")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
use posed_core::geometry::{Camera, Pose, Symmetries};
use posed_core::pnp::{self, solve};
use posed_core::views::{Mode, Reading, View, ViewsOptions, solve_views};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

/// Scenes that one timing goes through, so that no branch predictor learns a single one.
const SCENES: usize = 64;
const POINTS: usize = 14;

struct Seen {
    world_from_camera: Pose,
    readings: Vec<Reading>,
    modes: Vec<Mode>,
}

impl Seen {
    fn view<'a>(&'a self, camera: &'a Camera) -> View<'a> {
        let Self { world_from_camera, readings, modes } = self;
        View { camera, world_from_camera: *world_from_camera, camera_covariance: None, readings, modes, trust: 1.0 }
    }
}

fn scene(rng: &mut SmallRng, camera: &Camera, points: &[Vector3<f64>], views: usize) -> Vec<Seen> {
    let mut unit = || rng.random_range(-1.0..1.0f64);
    let view = |_| {
        let turn = Rotation3::new(Vector3::new(unit(), unit(), unit()) * 2.0);
        let camera_from_points = Pose::new(turn, Vector3::new(0.1 * unit(), 0.1 * unit(), 0.8 + 0.2 * unit()));
        let pixel = |point: &Vector3<f64>| {
            let error = Vector2::new(unit() + unit() + unit(), unit() + unit() + unit());
            camera.project(&camera_from_points.transform(point)).expect("in front of the camera") + error
        };
        let pixels: Vec<_> = points.iter().map(pixel).collect();
        let covariances = vec![Matrix2::identity(); POINTS];
        let alone = solve(points, &pixels, &covariances, camera, &pnp::Options::default()).expect("a pose");
        // As where a view's errors are known to be larger than its points say, along each axis by 1.7.
        let modes = Mode::all_of(&alone).iter().map(|mode| mode.with_covariance(&(mode.covariance * 2.9))).collect();
        let readings = vec![Reading { pixels, covariances_px: covariances }];
        Seen { world_from_camera: camera_from_points.inverse(), readings, modes }
    };
    (0..views).map(view).collect()
}

fn solving(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("views");
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).expect("a camera");
    let symmetries = Symmetries::default();
    for views in [2, 3, 8, 16] {
        let mut rng = SmallRng::seed_from_u64(views as u64);
        let points: Vec<_> =
            (0..POINTS).map(|_| Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0f64)).normalize() * 0.06).collect();
        let scenes: Vec<_> = (0..SCENES).map(|_| scene(&mut rng, &camera, &points, views)).collect();
        let options = ViewsOptions { tempering: 2.9, ..ViewsOptions::default() };
        let mut next = 0;
        group.bench_function(BenchmarkId::from_parameter(format!("{views} views of {POINTS} points")), |bencher| {
            bencher.iter(|| {
                next = (next + 1) % SCENES;
                let views: Vec<_> = black_box(&scenes[next]).iter().map(|seen| seen.view(&camera)).collect();
                solve_views(&points, &views, &symmetries, &options)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, solving);
criterion_main!(benches);
