//! A solve takes nothing from the heap: no latency from an allocator in a control loop.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nalgebra::{Matrix2, Vector2, Vector3};
use posed_core::geometry::Camera;
use posed_core::pnp::{MAX_POINTS, Options, solve};

#[test]
fn no_heap_whatever_the_input() {
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5)
        .unwrap()
        .with_opencv_distortion(&[-0.2, 0.05, 0.001, 0.0, 0.0])
        .unwrap();
    let options = Options::default();
    for count in 4..=MAX_POINTS {
        // Points on a spiral, their last one seen in a wrong place, so that every triplet is tried.
        let at = |k: usize| (k as f64).sin_cos();
        let points: Vec<_> =
            (0..count).map(|k| Vector3::new(0.08 * at(k).0, 0.08 * at(k).1, 0.01 * k as f64)).collect();
        let mut pixels: Vec<_> =
            points.iter().map(|p| camera.project(&(p + Vector3::new(0.02, 0.01, 0.6))).unwrap()).collect();
        pixels[count - 1] += Vector2::new(60.0, 30.0);
        let covariances = vec![Matrix2::identity(); count];
        let mut solved = false;
        let taken = allocation_counter::measure(|| {
            solved = solve(&points, &pixels, &covariances, &camera, &options).is_ok();
        });
        assert!(solved);
        assert_eq!(taken.count_total, 0, "{count} points");
    }
}
