//! Keypoints beyond the domain of the lens model.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to a network's floats, and to pixels")]

use std::sync::Arc;

use nalgebra::Vector2;
use posed::estimator::{Estimate, Reason};
use posed::model::Input;
use posed_core::pnp::Status;

use crate::script::{Manifests, Models, Script, batch_of, camera, corners, image, in_crop, sure_of, truth};

/// r (1 - 0.9 r²) grows up to where it is 0.406: 162 pixels from the centre of the image.
const FOLD: [f64; 4] = [-0.9, 0.0, 0.0, 0.0];
const BEYOND: Vector2<f64> = Vector2::new(10.0, 10.0);

/// The answer where the net sees so many of the corners beyond the domain, and the others right.
fn estimate(beyond: usize) -> Estimate {
    let camera = camera().with_opencv_distortion(&FOLD).unwrap();
    let of_net = camera.clone();
    let net = Arc::new(move |input: Input<'_>| {
        let pixel = |corner| of_net.project(&truth().transform(&corner)).unwrap();
        let mut pixels = corners().map(pixel);
        pixels[..beyond].fill(BEYOND);
        let pixels: Vec<f32> = pixels.map(in_crop).as_flattened().iter().map(|v| *v as f32).collect();
        Ok(sure_of(batch_of(input), pixels.repeat(batch_of(input))))
    });
    let models = Models::new(&Manifests::default(), Script { keypoints: net, ..Script::default() });
    models.estimator().unwrap().estimate(&image(50), &camera).unwrap()
}

#[test]
fn a_keypoint_beyond_the_lens_is_left_out_and_said_to_be() {
    let estimate = estimate(1);
    let solved = estimate.poses[0].pose.as_ref().unwrap();
    assert_eq!(estimate.poses[0].verdict.status, Status::Ok);
    assert!(solved.camera_from_object.angle_to(&truth()) < 1e-3);
    assert_eq!((solved.outside_lens, solved.inlier_count()), (1, 7));
    for (index, keypoint) in solved.keypoints.iter().enumerate() {
        assert_eq!((keypoint.inlier, keypoint.residual_px.is_some()), (index != 0, index != 0));
    }
    assert!(solved.reprojection_rmse_px < 0.1);
}

#[test]
fn many_keypoints_beyond_the_lens_are_few_inliers() {
    let few = estimate(4);
    assert_eq!(few.poses[0].verdict.status, Status::LowConfidence);
    assert!(few.poses[0].verdict.reasons.contains(Reason::FewInliers));
    assert_eq!(few.poses[0].pose.as_ref().unwrap().outside_lens, 4);
    let none = estimate(5);
    assert!(none.poses[0].pose.is_none() && none.poses[0].verdict.status == Status::Rejected);
}
