//! What one image or one crop spoils is its own.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to a network's floats, and to pixels")]

use std::sync::Arc;

use image::RgbImage;
use posed::estimator::{Estimate, EstimateError, Frame, Reason};
use posed::model::{Input, Output, RuntimeError};
use posed_core::pnp::Status;
use serde_json::json;

use crate::script::{
    BOX, Manifests, Models, Script, batch_of, brightness, camera, colour, end2end, image, keypoints, keypoints_in_crop,
    output, truth,
};

/// Images or crops of this brightness are the script's cue.
const CUE: u8 = 77;

/// The brightness in the middle of each crop.
fn brightnesses(input: Input<'_>) -> Vec<u8> {
    let Input::Bytes { shape, values } = input else { panic!("bytes were expected") };
    let crop = values.len() / shape[0];
    values.chunks_exact(crop).map(|crop| crop[(shape[1] / 2 * shape[2] + shape[2] / 2) * 3]).collect()
}

fn estimate_all(manifests: &Manifests, script: Script, images: &[RgbImage]) -> Vec<Result<Estimate, EstimateError>> {
    let camera = camera();
    let frames: Vec<Frame<'_>> = images.iter().map(|image| Frame::new(image, &camera)).collect();
    Models::new(manifests, script).estimator().unwrap().estimate_all(&frames)
}

fn assert_right(answer: &Result<Estimate, EstimateError>) {
    let poses = &answer.as_ref().unwrap().poses;
    assert_eq!((poses.len(), poses[0].verdict.status), (1, Status::Ok));
    assert!(poses[0].pose.as_ref().unwrap().camera_from_object.angle_to(&truth()) < 1e-3);
}

/// Outputs whose keypoints of some crops are no numbers.
fn spoilt(batch: usize, name: &str, spoil: impl Fn(usize) -> bool) -> Vec<Output> {
    let mut outputs = keypoints(batch);
    let values = &mut outputs.iter_mut().find(|output| output.name == name).unwrap().values;
    let of_crop = values.len() / batch;
    for crop in (0..batch).filter(|crop| spoil(*crop)) {
        values[crop * of_crop + 3] = f32::NAN;
    }
    outputs
}

#[test]
fn a_network_that_fails_on_one_image_answers_the_others_of_its_batch() {
    let net = Arc::new(|input: Input<'_>| {
        if brightnesses(input).contains(&CUE) {
            return Err(RuntimeError::Run { name: "scripted".into(), reason: "no memory".into() });
        }
        Ok(keypoints(batch_of(input)))
    });
    let images = [10, CUE, 20, 30].map(image);
    let answers = estimate_all(&Manifests::default(), Script { keypoints: net, ..Script::default() }, &images);
    let message = answers[1].as_ref().unwrap_err().to_string();
    assert!(message.contains("no memory"), "{message}");
    for index in [0, 2, 3] {
        assert_right(&answers[index]);
    }
}

/// Both objects of an image are in one batch; one of them gets values that are no numbers.
#[test]
fn values_that_are_no_numbers_spoil_their_own_box() {
    for name in ["keypoints", "covariances", "peaks"] {
        let mut rows = end2end().values;
        let mut right = rows.clone();
        right[0] += 95.0;
        right[2] += 95.0;
        rows.extend(right);
        let detector = Arc::new(move |_: Input<'_>| Ok(vec![output("detections", &[1, 2, 6], rows.clone())]));
        let net = Arc::new(move |input: Input<'_>| {
            let cues = brightnesses(input);
            Ok(spoilt(cues.len(), name, |crop| cues[crop] == CUE))
        });
        let middle = (BOX[0] + BOX[2] + 3.0) as u32;
        let halves = RgbImage::from_fn(320, 256, |x, _| colour(if x < middle { 10 } else { CUE }));
        let script = Script { detector, keypoints: net, ..Script::default() };
        let answers = estimate_all(&Manifests::default(), script, &[halves, image(10)]);
        let [good, bad] = &answers[0].as_ref().unwrap().poses[..] else { panic!("two boxes, two answers") };
        assert_eq!(good.verdict.status, Status::Ok, "{name}");
        assert_eq!(bad.verdict.status, Status::Rejected, "{name}");
        assert!(bad.verdict.reasons.iter().eq([Reason::NotFinite]) && bad.pose.is_none(), "{name}");
        assert!(answers[1].as_ref().unwrap().poses.iter().all(|pose| pose.verdict.status == Status::Ok), "{name}");
    }
}

#[test]
fn a_crop_of_an_ensemble_that_is_no_numbers_is_left_out() {
    let mut manifests = Manifests::default();
    manifests.object["crop_ensemble"] = json!([{"scale": 1.0}, {"scale": 1.0}, {"scale": 1.0}]);
    for bad in 0..3 {
        let net = Arc::new(move |input: Input<'_>| Ok(spoilt(batch_of(input), "keypoints", |crop| crop == bad)));
        let answers = estimate_all(&manifests, Script { keypoints: net, ..Script::default() }, &[image(10)]);
        assert_right(&answers[0]);
    }
}

/// A detector that adds a row to the object's where the image is of the cue's brightness.
fn adding(row: [f32; 6]) -> Script {
    let detector = Arc::new(move |input: Input<'_>| {
        let mut rows = end2end().values;
        if brightness(input) == CUE {
            rows.extend(row);
        }
        Ok(vec![output("detections", &[1, rows.len() / 6, 6], rows)])
    });
    Script { detector, ..Script::default() }
}

const NAN: f32 = f32::NAN;

#[test]
fn rows_that_do_not_count_may_be_no_numbers() {
    for row in [
        [NAN, NAN, NAN, NAN, 0.2, 0.0],
        [NAN, 0.0, f32::INFINITY, 0.0, 0.9, 7.0],
        [10.0, 10.0, 60.0, 60.0, 0.9, NAN],
        [10.0, 10.0, 60.0, 60.0, NAN, 0.0],
        [NAN; 6],
        [0.0, 0.0, 50.0, 50.0, f32::NEG_INFINITY, 0.0],
    ] {
        assert_right(&estimate_all(&Manifests::default(), adding(row), &[image(CUE)])[0]);
    }
}

#[test]
fn a_box_that_counts_and_is_no_numbers_is_its_images_error() {
    for row in [
        [NAN, 0.0, 50.0, 50.0, 0.8, 0.0],
        [0.0, 0.0, f32::INFINITY, 50.0, 0.8, 0.0],
        [0.0, 0.0, 9.0, 9.0, f32::INFINITY, 0.0],
    ] {
        let answers = estimate_all(&Manifests::default(), adding(row), &[10, CUE, 20].map(image));
        let message = answers[1].as_ref().unwrap_err().to_string();
        assert!(message.contains("is not finite"), "{message}");
        assert_right(&answers[0]);
        assert_right(&answers[2]);
    }
}

/// An empty answer would say that nothing is in view.
#[test]
fn a_detector_that_overflows_is_an_error() {
    let detector = Arc::new(|_: Input<'_>| Ok(vec![output("detections", &[1, 2, 6], vec![NAN; 12])]));
    let answers = estimate_all(&Manifests::default(), Script { detector, ..Script::default() }, &[image(10)]);
    let message = answers[0].as_ref().unwrap_err().to_string();
    assert!(message.contains("none of its 2 scores"), "{message}");
}

/// A net whose batch axis is 1 is found at the start, and gets its crops one by one.
#[test]
fn a_network_for_one_crop_at_a_time_gets_one_at_a_time() {
    let net = Arc::new(|input: Input<'_>| {
        if batch_of(input) > 1 {
            return Err(RuntimeError::Run { name: "scripted".into(), reason: "invalid dimensions".into() });
        }
        Ok(keypoints(1))
    });
    // Or it takes several, and answers as if it were one.
    let forgetful = Arc::new(|_: Input<'_>| Ok(keypoints(1)));
    assert_eq!(keypoints_in_crop().len(), 8);
    for net in [net as Arc<dyn Fn(Input<'_>) -> Result<Vec<Output>, RuntimeError> + Send + Sync>, forgetful] {
        let models = Models::new(&Manifests::default(), Script { keypoints: net, ..Script::default() });
        let mut estimator = models.estimator().unwrap();
        estimator.warm_up().unwrap();
        let (images, camera) = ([10, 20, 30].map(image), camera());
        let frames: Vec<Frame<'_>> = images.iter().map(|image| Frame::new(image, &camera)).collect();
        estimator.estimate_all(&frames).iter().for_each(assert_right);
    }
}
