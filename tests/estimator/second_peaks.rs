//! Heatmaps with two peaks, and crops that look unlike those of training.

#![allow(clippy::cast_possible_truncation, reason = "to a network's floats")]

use std::sync::Arc;

use nalgebra::{Matrix2, Vector2};
use posed::estimator::{EstimateError, ObjectPose, Reason};
use posed::model::{Input, Output};
use posed_core::geometry::Pose;
use posed_core::pnp::Status;
use serde_json::json;

use crate::script::{
    Manifests, Models, Script, batch_of, camera, corner_pixels, corners, image, in_crop, output, truth,
};

/// What a net says of each corner: both peaks in the crop, and the second one's mass, of the first one's.
#[derive(Clone, Copy)]
struct Seen {
    first: Vector2<f64>,
    second: Vector2<f64>,
    weight: f64,
}

/// The other pose that the image may show.
fn other() -> Pose {
    Pose::from_quaternion_xyzw([0.8, -0.3, 0.5, 0.141_421], [-0.02, -0.017, 0.5]).unwrap()
}

fn other_pixels() -> [Vector2<f64>; 8] {
    corners().map(|corner| camera().project(&other().transform(&corner)).unwrap())
}

fn seen(weight: f64) -> [Seen; 8] {
    let (first, second) = (corner_pixels(), other_pixels());
    std::array::from_fn(|k| Seen { first: first[k], second: second[k], weight })
}

/// The outputs of a net that sees this in every crop of the box.
fn outputs(seen: &[Seen; 8], batch: usize) -> Vec<Output> {
    let flat = |pixel: fn(&Seen) -> Vector2<f64>| -> Vec<f32> {
        seen.iter().flat_map(|seen| in_crop(pixel(seen))).map(|v| v as f32).collect::<Vec<_>>().repeat(batch)
    };
    let covariance = |seen: &Seen| {
        let apart = Vector2::from(in_crop(seen.second)) - Vector2::from(in_crop(seen.first));
        Matrix2::identity() * 0.1 + apart * apart.transpose() * (seen.weight / (1.0 + seen.weight))
    };
    let covariances = seen.iter().flat_map(|seen| covariance(seen).as_slice().to_vec()).map(|v| v as f32);
    vec![
        output("keypoints", &[batch, 8, 2], flat(|seen| seen.first)),
        output("covariances", &[batch, 8, 2, 2], covariances.collect::<Vec<_>>().repeat(batch)),
        output("peaks", &[batch, 8], vec![0.6; 8 * batch]),
        output("second_keypoints", &[batch, 8, 2], flat(|seen| seen.second)),
        output(
            "second_weights",
            &[batch, 8],
            seen.iter().map(|seen| seen.weight as f32).collect::<Vec<_>>().repeat(batch),
        ),
    ]
}

fn script(keypoints: impl Fn(Input<'_>) -> Vec<Output> + Send + Sync + 'static) -> Script {
    Script { keypoints: Arc::new(move |input| Ok(keypoints(input))), ..Script::default() }
}

fn answer_of(models: &Models) -> Result<ObjectPose, EstimateError> {
    let estimate = models.estimator()?.estimate(&image(50), &camera())?;
    let [pose] = &estimate.poses[..] else { panic!("one object, one answer") };
    Ok(pose.clone())
}

fn answer(seen: &[Seen; 8]) -> ObjectPose {
    let seen = *seen;
    answer_of(&Models::new(&Manifests::default(), script(move |input| outputs(&seen, batch_of(input))))).unwrap()
}

/// Angles of the answer and of its first alternative to a pose, radians, and the alternative's weight.
fn to(pose: &Pose, answer: &ObjectPose) -> (f64, f64, f64) {
    let solved = answer.pose.as_ref().unwrap();
    let [(alternative, weight), ..] = &solved.alternatives[..] else { panic!("no alternative") };
    (solved.camera_from_object.angle_to(pose), alternative.angle_to(pose), *weight)
}

#[test]
fn two_answers_are_both_given_with_the_shares_of_their_peaks() {
    let answer = answer(&seen(0.5));
    assert_eq!(answer.verdict.status, Status::Ambiguous);
    assert!(answer.verdict.reasons.contains(Reason::TwoAnswers));
    let (own, alternative, weight) = to(&other(), &answer);
    assert!(to(&truth(), &answer).0 < 0.01 && alternative < 0.01 && own > 0.3);
    assert!((weight - 1.0 / 3.0).abs() < 0.02, "{weight}");
    let solved = answer.pose.unwrap();
    assert!((solved.weight - 2.0 / 3.0).abs() < 0.02, "{}", solved.weight);
    // Each is said with the peaks that show it: other views will tell which is right.
    let observed = &solved.observed;
    assert_eq!((observed.readings.len(), observed.modes[0].reading, observed.modes[1].reading), (2, 0, 1));
    for mode in &observed.modes[..2] {
        for (corner, pixel) in corners().iter().zip(&observed.readings[mode.reading].pixels) {
            let projected = camera().project(&mode.camera_from_points.transform(corner)).unwrap();
            assert!((projected - pixel).norm() < 0.5, "{projected} {pixel}");
        }
    }
    // As sharp as its peaks are.
    assert!(solved.reprojection_rmse_px < 0.1 && solved.image_covariance[(2, 2)].sqrt() < 0.01);
}

#[test]
fn first_peaks_of_both_answers_make_no_pose_between_them() {
    for swapped in [[0, 3, 5], [1, 2, 6]] {
        let mut mixed = seen(0.8);
        for k in swapped {
            let Seen { first, second, weight } = mixed[k];
            mixed[k] = Seen { first: second, second: first, weight };
        }
        let answer = answer(&mixed);
        let (own, alternative, _) = to(&truth(), &answer);
        assert!(own < 0.01, "{own}: the pose that most first peaks show");
        assert!(alternative > 0.3 && to(&other(), &answer).1 < 0.01);
        assert!(answer.pose.unwrap().keypoints.iter().all(|keypoint| keypoint.inlier));
    }
}

#[test]
fn faint_or_scattered_second_peaks_change_nothing() {
    let faint = answer(&seen(0.03));
    let mut scattered = seen(0.4);
    for (k, one) in scattered.iter_mut().enumerate() {
        let k = k as f64;
        one.second = Vector2::new(110.0 + 9.0 * k, 70.0 + (37.0 * k) % 90.0);
    }
    let scattered = answer(&scattered);
    for answer in [faint, scattered] {
        assert_eq!(answer.verdict.status, Status::Ok, "{:?}", answer.verdict.reasons.iter().collect::<Vec<_>>());
        assert!(answer.pose.unwrap().camera_from_object.angle_to(&truth()) < 0.01);
    }
}

#[test]
fn second_peaks_of_another_shape_are_named() {
    let broken = |change: fn(&mut Vec<Output>)| {
        let models = Models::new(
            &Manifests::default(),
            script(move |input| {
                let mut all = outputs(&seen(0.1), batch_of(input));
                change(&mut all);
                all
            }),
        );
        answer_of(&models).unwrap_err().to_string()
    };
    let message = broken(|all| all[3].shape = vec![1, 4, 4]);
    assert!(message.contains("second_keypoints") && message.contains("[1, 8, 2]"), "{message}");
    let message = broken(|all| drop(all.pop()));
    assert!(message.contains("second_weights") && message.contains("missing"), "{message}");
}

/// The answer of a model that trusts what is familiar, and finds its crops so unfamiliar.
fn answer_to_unfamiliar(unfamiliarity: Vec<f32>) -> Result<ObjectPose, EstimateError> {
    let mut manifests = Manifests::default();
    let constant = |constant: f64| json!({"constant": constant});
    manifests.object["trust"] = json!({
        "ranges": {"unfamiliarity": [0.0, 5.0]},
        "covariance": {"depth": constant(0.0), "lateral": constant(0.0), "rotation": constant(0.0)},
        "probability": {"constant": 4.0, "weights": {"unfamiliarity": -2.0}},
        "ok_probability": 0.9,
    });
    let outputs = move |input: Input<'_>| {
        let mut all = outputs(&seen(0.0), batch_of(input));
        all.push(output("unfamiliarity", &[unfamiliarity.len()], unfamiliarity.clone()));
        all
    };
    answer_of(&Models::new(&manifests, script(outputs)))
}

#[test]
fn crops_unlike_those_of_training_are_trusted_less() {
    let alike = answer_to_unfamiliar(vec![1.0]).unwrap();
    assert!(alike.pose.as_ref().unwrap().evidence.unfamiliarity.abs() < 1e-6);
    assert_eq!(alike.verdict.status, Status::Ok);
    let unlike = answer_to_unfamiliar(vec![3.0]).unwrap();
    assert!((unlike.pose.as_ref().unwrap().evidence.unfamiliarity - 3_f64.ln()).abs() < 1e-6);
    assert!(unlike.verdict.reasons.iter().eq([Reason::Improbable]));
    let message = answer_to_unfamiliar(vec![1.0; 3]).unwrap_err().to_string();
    assert!(message.contains("unfamiliarity") && message.contains("[1]"), "{message}");
}
