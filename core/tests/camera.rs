//! Camera models against OpenCV: `benches/compare/camera_golden.py` wrote the values.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nalgebra::{Vector2, Vector3};
use posed_core::geometry::Camera;
use serde::Deserialize;

#[derive(Deserialize)]
struct Golden {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    camera: Camera,
    points_in_camera_m: Vec<[f64; 3]>,
    pixels: Vec<[f64; 2]>,
    /// x and y of the rays on the plane z = 1, from the pixels.
    rays: Vec<[f64; 2]>,
}

#[test]
fn cameras_agree_with_opencv() {
    let golden: Golden = serde_json::from_str(include_str!("data/opencv_cameras.json")).unwrap();
    assert_eq!(golden.cases.len(), 6);
    for case in golden.cases {
        for ((point, pixel), ray) in case.points_in_camera_m.iter().zip(&case.pixels).zip(&case.rays) {
            let (point, pixel) = (Vector3::from(*point), Vector2::from(*pixel));
            let projected = case.camera.project(&point).unwrap();
            assert!((projected - pixel).norm() < 1e-9, "{}: {projected} instead of {pixel}", case.name);
            let found = case.camera.unproject(&pixel).unwrap();
            assert!((found - point.xy() / point.z).norm() < 1e-10, "{}: {found} is not the ray of {point}", case.name);
            // OpenCV's own inversion iterates less exactly.
            assert!((found - Vector2::from(*ray)).norm() < 1e-6, "{}: {found} instead of {ray:?}", case.name);
        }
    }
}
