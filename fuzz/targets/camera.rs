//! Cameras as JSON: what is accepted projects, and undoes what it projects.
#![no_main]

use libfuzzer_sys::fuzz_target;
use posed_core::geometry::Camera;

fuzz_target!(|bytes: &[u8]| {
    let Ok(camera) = serde_json::from_slice::<Camera>(bytes) else { return };
    let _ = camera.for_resized(640, 480);
    for point in [[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [2.0, 1.0, 0.5], [0.1, 0.1, -1.0]] {
        if let Ok(pixel) = camera.project(&point.into()) {
            assert!(pixel.iter().all(|value| value.is_finite()), "{pixel}");
            let _ = camera.unproject(&pixel);
        }
    }
});
