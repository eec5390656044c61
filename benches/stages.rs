//! What a 640x480 JPEG with four objects costs outside the networks: decoding, resampling, solving, the answer's JSON.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use fast_image_resize::Resizer;
use nalgebra::{Matrix2, Vector2, Vector3};
use posed::estimator::{
    Answer, CallerFrames, Detection, Estimate, ObjectPose, Observed, SolvedKeypoint, SolvedPose, Timings, Verdict,
};
use posed::model::{Catalogue, Evidence, Library, Provider, References};
use posed::server::api::json::{Report, ReportContext};
use posed::vision::{BoundingBox, DecodeOptions, Exif, Fit, Image, Letterbox, Square, crop_squares, decode, letterbox};
use posed_core::geometry::{Camera, Covariance6, Pose};
use posed_core::pnp::{Options, solve};

fn stages(criterion: &mut Criterion) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("samples/sample-3.jpg");
    let bytes = std::fs::read(path).unwrap_or_default();
    let encoded = Image::Encoded(bytes.into());
    let Ok(decoded) = decode(&encoded, &DecodeOptions::default()) else { return };
    let image = decoded.image;
    let mut resizer = Resizer::new();
    let region = BoundingBox { x: 200.0, y: 150.0, width: 110.0, height: 90.0 };

    criterion.bench_function("decode the JPEG", |b| b.iter(|| decode(black_box(&encoded), &DecodeOptions::default())));
    let to = Letterbox { width: 320, height: 256, fill: 114, fit: Fit::TopLeft };
    criterion.bench_function("letterbox for the detector", |b| {
        b.iter(|| letterbox(&mut resizer, black_box(&image), to));
    });
    let square = Square::around(&region).scaled(1.5);
    let second_look = [(0.95, 0.3), (1.0, 0.5), (1.05, 0.7)].map(|(scale, turn)| square.scaled(scale).turned(turn));
    for (name, squares) in [("cut a first crop", &[square][..]), ("cut the crops of a second look", &second_look)] {
        criterion.bench_function(name, |b| {
            b.iter(|| crop_squares(&mut resizer, black_box(&image), squares, 160));
        });
    }
    let (points, pixels) = problem();
    let Ok(camera) = Camera::pinhole(600.0, 600.0, 319.5, 239.5) else { return };
    criterion.bench_function("solve four poses", |b| {
        b.iter(|| {
            for _ in 0..4 {
                black_box(solve(&points, &pixels, &[Matrix2::identity(); 8], &camera, &Options::default())).ok();
            }
        });
    });
    criterion.bench_function("write the answer", |b| {
        let Ok(library) = Library::load(Path::new("models")).map(Arc::new) else { return };
        let Ok(references) = References::load(Path::new("reference"), &library).map(Arc::new) else { return };
        let catalogue = Arc::new(Catalogue { library, references });
        let (answer, frames) = (answer(region, &camera, catalogue), CallerFrames::default());
        let context = ReportContext { provider: Provider::Cpu, frames: &frames, captured_at: None };
        b.iter(|| serde_json::to_vec(&Report::new(&answer, &context)));
    });
}

fn problem() -> (Vec<Vector3<f64>>, Vec<Vector2<f64>>) {
    let points: Vec<_> =
        (0..8).map(|k| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { 0.03 } else { -0.03 })).collect();
    let pixels =
        points.iter().map(|p| Vector2::new(p.x - 0.3 * p.z, p.y + 0.2 * p.x) * 1000.0 + Vector2::new(250.0, 190.0));
    let pixels = pixels.collect();
    (points, pixels)
}

fn answer(bounding_box: BoundingBox, camera: &Camera, catalogue: Arc<Catalogue>) -> Answer {
    let found = ObjectPose {
        object: "cube".into(),
        verdict: Verdict::default(),
        detection: Detection { object: 0, bounding_box, score: 0.9, given: None },
        track: None,
        pose: Some(SolvedPose {
            camera_from_object: Pose::identity(),
            camera_from_keypoints: Pose::identity(),
            covariance: Covariance6::identity(),
            image_covariance: Covariance6::identity(),
            reprojection_rmse_px: 1.0,
            keypoints: vec![
                SolvedKeypoint { pixel: Vector2::zeros(), peak: 0.9, residual_px: Some(1.0), inlier: true };
                8
            ],
            outside_lens: 0,
            alternatives: Vec::new(),
            weight: 1.0,
            observed: Observed::default(),
            keypoints_scale: 1.0,
            evidence: Evidence::default(),
            probability: None,
            box_in_camera: [Vector3::zeros(); 8],
        }),
        diameter_m: 0.09,
    };
    let estimate = Estimate {
        width: 640,
        height: 480,
        poses: vec![found; 4],
        camera: camera.clone(),
        camera_scaled_from: None,
        truncated: false,
        hints: Vec::new(),
        timings: Timings::default(),
        catalogue,
    };
    Answer {
        estimate,
        exif: Exif { orientation: 1, applied: false },
        image: None,
        room: None,
        batch_size: 1,
        queued: Duration::ZERO,
        decode: Duration::ZERO,
        total: Duration::ZERO,
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
