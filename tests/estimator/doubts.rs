//! What is said against a pose that its keypoints agree with.

use image::{Rgb, RgbImage};
use posed::estimator::Reason;
use posed_core::geometry::Camera;
use posed_core::pnp::Status;

use crate::script::{HEIGHT, Manifests, Models, Script, WIDTH, camera, image};

/// The reasons for the only pose's status.
fn reasons(manifests: &Manifests, image: &RgbImage, camera: &Camera) -> (Status, Vec<Reason>) {
    let estimate = Models::new(manifests, Script::default()).estimator().unwrap().estimate(image, camera).unwrap();
    let verdict = estimate.poses[0].verdict;
    (verdict.status, verdict.reasons.iter().collect())
}

#[test]
fn an_image_that_cannot_be_judged_is_not_trusted() {
    let manifests = Manifests::default();
    assert_eq!(reasons(&manifests, &image(50), &camera()), (Status::Ok, vec![]));
    let grey = |level: u8| RgbImage::from_fn(WIDTH, HEIGHT, |x, _| Rgb([level.saturating_add((x % 32) as u8); 3]));
    assert_eq!(reasons(&manifests, &grey(90), &camera()), (Status::LowConfidence, vec![Reason::GreyImage]));
    let dark = RgbImage::from_fn(WIDTH, HEIGHT, |x, y| Rgb([(x % 30) as u8, (y % 30) as u8, 0]));
    assert_eq!(reasons(&manifests, &dark, &camera()), (Status::LowConfidence, vec![Reason::DarkImage]));
}

#[test]
fn the_camera_of_another_image_is_suspected() {
    // As if the image were a region at the sensor's left edge, and the parameters the whole sensor's.
    let region = Camera::pinhole(400.0, 400.0, 400.0, 128.0).unwrap();
    let (status, found) = reasons(&Manifests::default(), &image(50), &region);
    assert!(status >= Status::LowConfidence && found.contains(&Reason::CameraSuspect), "{status} {found:?}");
    let mut large = Manifests::default();
    large.object["diameter_m"] = 0.6.into();
    let (status, found) = reasons(&large, &image(50), &camera());
    assert!(status >= Status::LowConfidence && found.contains(&Reason::TooNear), "{status} {found:?}");
}
