//! The shipped networks.

use std::path::Path;
use std::sync::Arc;

use posed::estimator::{Estimate, Estimator, Frame};
use posed::model::{Library, References};
use posed::vision::{DecodeOptions, Image, decode};
use posed_core::geometry::{Camera, Pose};

use crate::script::runtime;

/// An answer does not depend on the images that it is worked on with: the arithmetic's order may differ in the last
/// digits of a float, and nothing else.
#[test]
fn an_answer_does_not_depend_on_its_batch() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let library = Arc::new(Library::load(&root.join("models")).unwrap());
    let references = Arc::new(References::load(&root.join("reference"), &library).unwrap());
    let mut estimator = Estimator::new(library, references, runtime()).unwrap();
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap();
    let images: Vec<_> = (1..=3)
        .map(|index| std::fs::read(root.join(format!("samples/sample-{index}.jpg"))).unwrap())
        .map(|bytes| decode(&Image::Encoded(bytes.into()), &DecodeOptions::default()).unwrap().image)
        .collect();
    let frames: Vec<_> = images.iter().chain(&images).map(|image| Frame::new(image, &camera)).collect();
    let together = estimator.estimate_all(&frames);
    let mut poses = 0;
    for (frame, together) in frames.iter().zip(together) {
        let alone = summary(&estimator.estimate(frame.image, &camera).unwrap());
        let together = summary(&together.unwrap());
        assert_eq!(alone.len(), together.len());
        for ((object, status, pose), (other_object, other_status, other)) in alone.iter().zip(&together) {
            assert_eq!((object, status), (other_object, other_status));
            assert!(pose.angle_to(other) < 1e-4, "{object}: {}", pose.angle_to(other));
            let distance = (pose.translation() - other.translation()).norm();
            assert!(distance < 1e-5, "{object}: {distance}");
            poses += 1;
        }
    }
    assert!(poses >= 12, "{poses}");
}

fn summary(estimate: &Estimate) -> Vec<(String, String, Pose)> {
    let solved = estimate.poses.iter().filter_map(|found| Some((found, found.pose.as_ref()?)));
    solved.map(|(f, pose)| (f.object.clone(), f.verdict.status.to_string(), pose.camera_from_object)).collect()
}
