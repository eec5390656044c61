use std::path::Path;

use nalgebra::Vector3;
use posed::evaluation::{Deviation, ModelPoints, ObjectMesh};
use posed_core::geometry::{BopSymmetries, Camera, METRES_PER_MILLIMETRE, Pose, Symmetries};
use serde::Deserialize;

const TOLERANCE: f64 = 1e-6;

#[derive(Deserialize)]
struct Golden {
    camera: Pinhole,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Pinhole {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    points_mm: Vec<[f64; 3]>,
    symmetries: BopSymmetries,
    truth: BopPose,
    estimate: BopPose,
    expected: Expected,
}

#[derive(Deserialize)]
struct BopPose {
    rotation: [f64; 9],
    translation_mm: [f64; 3],
}

#[derive(Deserialize)]
struct Expected {
    add: f64,
    adi: f64,
    mssd: f64,
    mspd: f64,
    proj: f64,
    re: Option<f64>,
    te: Option<f64>,
}

impl BopPose {
    fn pose(&self) -> Pose {
        Pose::from_row_major(self.rotation, self.translation_mm.map(|value| value * METRES_PER_MILLIMETRE)).unwrap()
    }
}

/// Of `benches/compare/bop_golden.py`.
fn golden() -> Golden {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bop_toolkit.json");
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn errors_are_those_of_the_bop_toolkit() {
    let Golden { camera: Pinhole { fx, fy, cx, cy }, cases } = golden();
    let camera = Camera::pinhole(fx, fy, cx, cy).unwrap();
    assert!(cases.len() >= 20 && cases.iter().any(|case| case.expected.re.is_none()));
    for case in cases {
        let vertices = case.points_mm.iter().map(|point| Vector3::from(*point) * METRES_PER_MILLIMETRE).collect();
        let symmetries = Symmetries::try_from(&case.symmetries).unwrap();
        let points = ModelPoints::new(&ObjectMesh { vertices, diameter_m: 0.15, symmetries }).unwrap();
        let (estimate, truth) = (case.estimate.pose(), case.truth.pose());
        let deviation = Deviation::new(&points, &camera, &estimate, &truth);
        let is = |what: &str, found: f64, expected: f64| {
            assert!((found - expected).abs() < TOLERANCE, "{}: {what} is {found}, not {expected}", case.name);
        };
        let in_mm = |value_m: f64| value_m / METRES_PER_MILLIMETRE;
        let expected = &case.expected;
        is("add", in_mm(points.add_m(&estimate, &truth)), expected.add);
        is("adi", in_mm(points.add_s_m(&estimate, &truth)), expected.adi);
        is("mssd", in_mm(deviation.mssd_m), expected.mssd);
        is("mspd", deviation.mspd_px, expected.mspd);
        if points.symmetries().is_trivial() {
            is("add of all errors", in_mm(deviation.add_m), expected.add);
            is("proj", deviation.projection_px, expected.proj);
        } else {
            is("adi of all errors", in_mm(deviation.add_m), expected.adi);
        }
        if let (Some(re), Some(te)) = (expected.re, expected.te) {
            is("re", deviation.rotation_deg, re);
            is("te", in_mm(deviation.translation_m), te);
        }
    }
}
