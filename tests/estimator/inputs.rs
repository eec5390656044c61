//! How networks from elsewhere want their images.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to a network's floats, and to pixels")]

use std::sync::Arc;

use half::f16;
use image::RgbImage;
use posed::model::Input;
use serde_json::{Value, json};

use crate::script::{BOX, HEIGHT, Manifests, Models, Script, WIDTH, batch_of, camera, keypoints, output};

const COLOUR: [u8; 3] = [255, 51, 0];
const MEAN: [f64; 3] = [0.1, 0.2, 0.3];
const STD: [f64; 3] = [0.5, 0.25, 0.125];

/// The first pixel of an input, in the order of its channels.
fn first_pixel(input: Input<'_>) -> [f64; 3] {
    let (shape, values): (_, Vec<f64>) = match input {
        Input::Bytes { shape, values } => (shape, values.iter().map(|v| f64::from(*v)).collect()),
        Input::Floats { shape, values } => (shape, values.iter().map(|v| f64::from(*v)).collect()),
        Input::Halves { shape, values } => (shape, values.iter().map(|v: &f16| v.to_f64()).collect()),
    };
    assert_eq!(values.len(), shape.iter().product::<usize>());
    match shape {
        [_, _, _, 3] => [0, 1, 2].map(|channel| values[channel]),
        [_, 3, height, width] => [0, 1, 2].map(|channel| values[channel * height * width]),
        _ => panic!("{shape:?}"),
    }
}

#[test]
fn pixels_come_in_the_stated_layout_type_and_order() {
    for layout in ["nhwc", "nchw"] {
        for channels in ["rgb", "bgr"] {
            for dtype in ["uint8", "float32", "float16"] {
                check_pixels(layout, channels, dtype);
            }
        }
    }
}

/// Both networks are told to see a colour.
fn check_pixels(layout: &str, channels: &str, dtype: &str) {
    let mut manifests = Manifests::default();
    for input in [&mut manifests.detector["input"], &mut manifests.object["input"]] {
        input["layout"] = layout.into();
        input["channels"] = channels.into();
        input["dtype"] = dtype.into();
        if dtype != "uint8" {
            input["mean"] = json!(MEAN);
            input["std"] = json!(STD);
        }
    }
    let mut wanted = COLOUR.map(f64::from);
    if channels == "bgr" {
        wanted.reverse();
    }
    if dtype != "uint8" {
        wanted = [0, 1, 2].map(|channel| (wanted[channel] / 255.0 - MEAN[channel]) / STD[channel]);
    }
    let case = format!("{layout} {channels} {dtype}");
    let check = move |input: Input<'_>| {
        let (found, of_type) = (
            first_pixel(input),
            match input {
                Input::Bytes { .. } => "uint8",
                Input::Floats { .. } => "float32",
                Input::Halves { .. } => "float16",
            },
        );
        assert!(case.ends_with(of_type), "{case}: {of_type}");
        assert!(found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 4e-3), "{case}: {found:?}");
    };
    let (of_detector, of_keypoints) = (check.clone(), check);
    let [x, y, w, h] = BOX.map(|v| v as f32);
    let script = Script {
        detector: Arc::new(move |input: Input<'_>| {
            of_detector(input);
            Ok(vec![output("detections", &[1, 1, 6], vec![x, y, x + w, y + h, 0.9, 0.0])])
        }),
        keypoints: Arc::new(move |input: Input<'_>| {
            of_keypoints(input);
            Ok(keypoints(batch_of(input)))
        }),
        ..Script::default()
    };
    let image = RgbImage::from_pixel(WIDTH, HEIGHT, image::Rgb(COLOUR));
    assert_eq!(
        Models::new(&manifests, script).estimator().unwrap().estimate(&image, &camera()).unwrap().poses.len(),
        1
    );
}

/// An image of half the width that the detector has, in each placement, with boxes in pixels and in shares.
#[test]
fn boxes_come_back_from_each_placement() {
    let [x, y, w, h] = BOX;
    let (width, height) = (f64::from(2 * WIDTH), f64::from(HEIGHT));
    for (placement, left, scale) in [
        ("top_left", 0.0, 1.0),
        ("centre", f64::from(WIDTH) / 2.0, 1.0),
        ("letterbox", f64::from(WIDTH) / 2.0, 1.0),
        ("stretch", 0.0, 2.0),
    ] {
        for (coordinates, unit) in [("pixels", [1.0, 1.0]), ("normalised", [width, height])] {
            let mut manifests = Manifests::default();
            manifests.detector["coordinates"] = coordinates.into();
            manifests.detector["input"]["width"] = (2 * WIDTH).into();
            manifests.detector["input"]["placement"] = placement.into();
            let across = |x: f64| ((x * scale + left) / unit[0]) as f32;
            let down = |y: f64| (y / unit[1]) as f32;
            let row = vec![across(x), down(y), across(x + w), down(y + h), 0.9, 0.0];
            let detector = Arc::new(move |_: Input<'_>| Ok(vec![output("detections", &[1, 1, 6], row.clone())]));
            let mut estimator = Models::new(&manifests, Script { detector, ..Script::default() }).estimator().unwrap();
            let image = RgbImage::from_pixel(WIDTH, HEIGHT, image::Rgb(COLOUR));
            let found = estimator.estimate(&image, &camera()).unwrap().poses[0].detection.bounding_box;
            let found = <[f64; 4]>::from(found);
            let case = format!("{placement} {coordinates}: {found:?}");
            assert!(found.iter().zip(BOX).all(|(found, wanted)| (found - wanted).abs() < 1e-2), "{case}");
        }
    }
}

/// What makes no sense is refused when the manifest is read, by its field.
#[test]
fn settings_that_make_no_sense_are_named() {
    type Change = fn(&mut Manifests) -> &mut Value;
    let cases: [(Change, Value, &str); 17] = [
        (|m| &mut m.detector["input"]["mean"], json!([0.5, 0.5, 0.5]), "'input.mean' is for"),
        (|m| &mut m.detector["input"]["std"], json!([0.5, 0.5, 0.5]), "'input.std' is for"),
        (|m| &mut m.detector["input"]["placement"], json!("middle"), "middle"),
        (|m| &mut m.detector["input"]["channels"], json!("rgba"), "rgba"),
        (|m| &mut m.detector["input"]["dtype"], json!("int8"), "int8"),
        (|m| &mut m.detector["input"]["width"], json!(0), "'input.width' is 0"),
        (|m| &mut m.detector["coordinates"], json!("metres"), "metres"),
        (|m| &mut m.detector["max_detections"], json!(0), "'max_detections' is 0"),
        (|m| &mut m.detector["max_detections_per_class"], json!(0), "'max_detections_per_class' is 0"),
        (|m| &mut m.detector["score_threshold"], json!(40), "'score_threshold' is 40"),
        (|m| &mut m.detector["iou_threshold"], json!(1.0), "'iou_threshold' is 1"),
        (|m| &mut m.detector["labels"], json!([null]), "'labels' has no object"),
        (|m| &mut m.detector["size_input"], json!("sizes"), "size_input"),
        (|m| &mut m.object["virtual_keypoints_m"], json!(vec![[0.01, 0.01, 0.01]; 8]), "'virtual_keypoints_m' are all"),
        (
            |m| &mut m.object["virtual_keypoints_m"],
            json!((0..8).map(|k| [0.01 * f64::from(k), 0.0, 0.02]).collect::<Vec<_>>()),
            "one line",
        ),
        (|m| &mut m.object["covariance_scale"], json!(vec![1e-300; 8]), "'covariance_scale' has the factor"),
        (|m| &mut m.object["diameter_m"], json!(91.7), "'diameter_m' is 91.7"),
    ];
    for (field, value, words) in cases {
        let mut manifests = Manifests::default();
        *field(&mut manifests) = value;
        assert_refused(&manifests, words);
    }
    let mut floats = Manifests::default();
    floats.detector["input"]["dtype"] = "float32".into();
    for (field, value) in
        [("mean", json!([123.675, 116.28, 103.53])), ("std", json!([58.395, 57.12, 57.375])), ("std", json!([0, 1, 1]))]
    {
        let mut manifests = floats.clone();
        manifests.detector["input"][field] = value;
        assert_refused(&manifests, &format!("'input.{field}' is ["));
    }
    let mut sized = Manifests::default();
    sized.detector["input"]["size_input"] = "orig_target_sizes".into();
    sized.detector["coordinates"] = "normalised".into();
    assert_refused(&sized, "'coordinates' is \"normalised\"");
}

fn assert_refused(manifests: &Manifests, words: &str) {
    let refusal = Models::load(manifests, Script::default()).err().unwrap().to_string();
    assert!(refusal.contains(words), "{refusal}, not {words}");
}
