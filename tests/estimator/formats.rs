//! Networks from elsewhere: other outputs, the same boxes and keypoints.

use std::sync::Arc;

use posed::estimator::{Estimate, EstimateError};
use posed::model::{Input, Output};
use posed_core::pnp::Status;
use serde_json::json;

use crate::script::{
    BOX, CROP, HEIGHT, Manifests, Models, Script, WIDTH, batch_of, camera, end2end, image, keypoints_in_crop, output,
    truth,
};

fn estimate(manifests: &Manifests, script: Script) -> Result<Estimate, EstimateError> {
    Models::new(manifests, script).estimator().unwrap().estimate(&image(50), &camera())
}

fn assert_right(estimate: &Estimate, angle_rad: f64, distance_m: f64) {
    let [found] = &estimate.poses[..] else { panic!("{} poses", estimate.poses.len()) };
    assert_eq!(found.verdict.status, Status::Ok);
    let pose = found.pose.as_ref().unwrap().camera_from_object;
    assert!(pose.angle_to(&truth()) < angle_rad, "{pose:?}");
    assert!((pose.translation() - truth().translation()).norm() < distance_m, "{pose:?}");
}

/// The box of an answer, to be compared between formats.
fn region(estimate: &Estimate) -> [f64; 4] {
    let region = estimate.poses[0].detection.bounding_box;
    [region.x, region.y, region.width, region.height]
}

fn with_detector(format: &str, outputs: Vec<Output>) -> Result<Estimate, EstimateError> {
    let mut manifests = Manifests::default();
    manifests.detector["format"] = format.into();
    // A class that is no object here, as the background of torchvision's detectors.
    manifests.detector["labels"] = json!([null, "block"]);
    let detector = Arc::new(move |_: Input<'_>| Ok(outputs.clone()));
    estimate(&manifests, Script { detector, ..Script::default() })
}

#[allow(clippy::cast_possible_truncation, reason = "to a network's floats")]
#[test]
fn every_detector_format_gives_the_same_boxes() {
    let [x, y, w, h] = BOX.map(|v| v as f32);
    let (cx, cy) = (x + w / 2.0, y + h / 2.0);
    // Beside the object: a weaker box of it in the same place, one below the threshold, one of the background.
    let rows = [
        // centre, size, objectness, background, block
        [cx, cy, w, h, 1.0, 0.1, 0.9],
        [cx + 4.0, cy, w, h, 1.0, 0.1, 0.8],
        [40.0, 40.0, 30.0, 30.0, 0.9, 0.1, 0.4],
        [200.0, 200.0, 30.0, 30.0, 1.0, 0.95, 0.2],
    ];
    let corners = |row: &[f32; 7]| {
        let [cx, cy, w, h, ..] = *row;
        [cx - w / 2.0, cy - h / 2.0, cx + w / 2.0, cy + h / 2.0]
    };
    let scores = [0.9, 0.8, 0.36, 0.95];
    let classes = [1.0, 1.0, 1.0, 0.0];
    let end2end = rows.iter().zip(scores).zip(classes);
    let end2end = end2end.flat_map(|((row, score), class)| corners(row).into_iter().chain([score, class])).collect();
    let yolov8 =
        [0, 1, 2, 3, 5, 6].map(|field| rows.map(|row| if field > 4 { row[4] * row[field] } else { row[field] }));
    let torchvision = vec![
        output("boxes", &[4, 4], rows.iter().flat_map(corners).collect()),
        output("labels", &[4], classes.to_vec()),
        output("scores", &[4], scores.to_vec()),
    ];
    let yolov7 = rows.iter().zip(scores).zip(classes);
    let yolov7 =
        yolov7.flat_map(|((row, score), class)| [0.0].into_iter().chain(corners(row)).chain([class, score])).collect();
    let efficient_nms = vec![
        output("num_dets", &[1, 1], vec![4.0]),
        output("det_boxes", &[1, 4, 4], rows.iter().flat_map(corners).collect()),
        output("det_scores", &[1, 4], scores.to_vec()),
        output("det_classes", &[1, 4], classes.to_vec()),
    ];
    for (format, outputs) in [
        ("end2end", vec![output("detections", &[1, 4, 6], end2end)]),
        ("yolov7_end2end", vec![output("output", &[4, 7], yolov7)]),
        ("efficient_nms", efficient_nms),
        ("yolov5", vec![output("output0", &[1, 4, 7], rows.as_flattened().to_vec())]),
        ("yolov8", vec![output("output0", &[1, 6, 4], yolov8.as_flattened().to_vec())]),
        ("torchvision", torchvision),
    ] {
        let answer = with_detector(format, outputs).unwrap();
        assert_right(&answer, 1e-4, 1e-4);
        assert!(region(&answer).iter().zip(BOX).all(|(found, wanted)| (found - wanted).abs() < 1e-3), "{format}");
        assert!((answer.poses[0].detection.score - 0.9).abs() < 1e-6, "{format}");
    }
}

#[test]
fn two_instances_of_a_class_are_two_poses() {
    let mut rows = end2end().values;
    let mut far = rows.clone();
    far[0] += 95.0;
    far[2] += 95.0;
    rows.extend(far);
    let detector = Arc::new(move |_: Input<'_>| Ok(vec![output("detections", &[1, 2, 6], rows.clone())]));
    let answer = estimate(&Manifests::default(), Script { detector, ..Script::default() }).unwrap();
    let x = |k: usize| answer.poses[k].pose.as_ref().unwrap().camera_from_object.translation().x;
    assert!(answer.poses.len() == 2 && (x(0) - x(1)).abs() > 0.05);
}

#[test]
fn outputs_of_another_shape_are_named() {
    for (format, outputs, words) in [
        ("end2end", vec![output("out", &[1, 6], vec![0.0; 6])], "[1, 6], expected [1, N, 6]"),
        ("yolov5", vec![output("out", &[1, 1, 9], vec![0.0; 9])], "[1, N, 7] for 2 labels"),
        ("yolov8", vec![output("out", &[1, 7, 1], vec![0.0; 7])], "[1, 6, N] for 2 labels"),
        ("yolov7_end2end", vec![output("out", &[1, 6], vec![0.0; 6])], "[1, 6], expected [N, 7]"),
        ("efficient_nms", vec![output("num_dets", &[1, 1], vec![0.0])], "has 1 outputs"),
        ("torchvision", vec![output("boxes", &[1, 4], vec![0.0; 4])], "'labels' is missing"),
        ("end2end", vec![], "is missing"),
    ] {
        let message = with_detector(format, outputs).unwrap_err().to_string();
        assert!(message.contains(words), "{format}: {message}");
    }
}

/// A centred letterbox of floats, of an image of half the detector's size: boxes come back to image pixels.
#[allow(clippy::cast_possible_truncation, reason = "to a network's floats")]
#[test]
fn boxes_come_back_through_a_centred_letterbox() {
    let mut manifests = Manifests::default();
    let (width, height) = (2 * WIDTH, 2 * HEIGHT + 64);
    manifests.detector["input"] = json!({
        "layout": "nchw", "dtype": "float32", "width": width, "height": height, "fill": 114, "placement": "centre",
    });
    let detector = Arc::new(move |input: Input<'_>| {
        let Input::Floats { shape, values } = input else { panic!("floats were expected") };
        assert_eq!(shape, [1, 3, height as usize, width as usize]);
        // The filling above, the image in the middle.
        assert!((values[0] - 114.0 / 255.0).abs() < 1e-6 && (values[values.len() / 6] - 50.0 / 255.0).abs() < 1e-6);
        let [x, y, w, h] = BOX.map(|v| 2.0 * v as f32);
        Ok(vec![output("detections", &[1, 1, 6], vec![x, y + 32.0, x + w, y + 32.0 + h, 0.9, 0.0])])
    });
    let answer = estimate(&manifests, Script { detector, ..Script::default() }).unwrap();
    assert_right(&answer, 1e-4, 1e-4);
}

/// A net that returns heatmaps of logits, from normalised floats.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to a network's floats")]
#[test]
fn heatmaps_are_decoded() {
    let mut manifests = Manifests::default();
    manifests.object["output"] = json!({"kind": "heatmaps"});
    manifests.object["input"] = json!({
        "layout": "nchw", "dtype": "float32", "size": CROP, "mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225],
    });
    let keypoints = Arc::new(|input: Input<'_>| {
        let Input::Floats { shape, values } = input else { panic!("floats were expected") };
        assert!((values[values.len() / 6] - (50.0 / 255.0 - 0.485) / 0.229).abs() < 1e-4, "the crop's middle is image");
        let side = CROP as usize;
        let map = |[u, v]: [f64; 2]| {
            (0..side * side).map(move |k| {
                let (du, dv) = ((k % side) as f64 - u, (k / side) as f64 - v);
                (-(du * du + dv * dv) / (2.0 * 1.2 * 1.2)) as f32
            })
        };
        let maps = keypoints_in_crop().into_iter().flat_map(map).collect::<Vec<f32>>();
        Ok(vec![output("heatmaps", &[shape[0], 8, side, side], maps.repeat(batch_of(input)))])
    });
    let answer = estimate(&manifests, Script { keypoints, ..Script::default() }).unwrap();
    assert_right(&answer, 2e-3, 1e-3);
}
