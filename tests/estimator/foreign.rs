//! Networks as other exporters write them, in ONNX Runtime.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "to a network's floats, and to pixels")]

use std::sync::Arc;

use image::RgbImage;
use posed::estimator::{Estimate, Estimator, Frame, Reason};
use posed::model::{Library, References};
use posed_core::pnp::Status;
use serde_json::json;

use crate::onnx::{Attribute, Element, Graph, Node, Tensor};
use crate::script::{
    BOX, CROP, HEIGHT, Manifests, Networks, WIDTH, camera, image, keypoints_in_crop, runtime, truth, write_models,
};

/// A keypoint net whose batch axis is 1, with outputs that nobody wants.
fn keypoints() -> Graph {
    let (side, pixels) = (i64::from(CROP), keypoints_in_crop());
    let pixels: Vec<f32> = pixels.as_flattened().iter().map(|v| *v as f32).collect();
    Graph::default()
        .input("image", Element::Uint8, &[1, side, side, 3])
        .answer(Tensor::strings("version", &["2", "beta"]))
        .answer(Tensor::bools("valid", &[1, 8], &[true; 8]))
        .answer(Tensor::int64s("indices", &[8], &[0, 1, 2, 3, 4, 5, 6, 7]))
        .answer(Tensor::floats("peaks", &[1, 8], &[0.9; 8]))
        .answer(Tensor::floats("keypoints", &[1, 8, 2], &pixels))
        .answer(Tensor::floats("covariances", &[1, 8, 2, 2], &[0.1, 0.0, 0.0, 0.1].repeat(8)))
}

fn corners() -> [f32; 4] {
    [BOX[0], BOX[1], BOX[0] + BOX[2], BOX[1] + BOX[3]].map(|v| v as f32)
}

fn start(manifests: &Manifests, detector: Graph) -> Result<Estimator, String> {
    start_with(manifests, detector, keypoints())
}

fn start_with(manifests: &Manifests, detector: Graph, keypoints: Graph) -> Result<Estimator, String> {
    let folder = tempfile::tempdir().unwrap();
    write_models(folder.path(), manifests, &Networks { detector: &detector.file(), keypoints: &keypoints.file() });
    let library = Arc::new(Library::load(folder.path()).map_err(|error| error.to_string())?);
    let references = Arc::new(References::load(folder.path(), &library).unwrap());
    let mut estimator = Estimator::new(library, references, runtime()).map_err(|error| error.to_string())?;
    estimator.warm_up().map_err(|error| error.to_string())?;
    Ok(estimator)
}

fn assert_right(answer: &Estimate) {
    let [found] = &answer.poses[..] else { panic!("{} poses", answer.poses.len()) };
    assert_eq!(found.verdict.status, Status::Ok);
    let [x, y, width, height] = BOX;
    let region = found.detection.bounding_box;
    let apart = [region.x - x, region.y - y, region.width - width, region.height - height];
    assert!(apart.iter().all(|difference| difference.abs() < 0.1), "{region:?}");
    assert!(found.pose.as_ref().unwrap().camera_from_object.angle_to(&truth()) < 1e-3);
}

/// As a network that overflows on some crops: one that shows nothing but black gets no numbers.
#[test]
fn a_crop_without_numbers_is_its_own_images_matter() {
    let (side, [x1, y1, x2, y2]) = (i64::from(CROP), corners());
    let pixels: Vec<f32> = keypoints_in_crop().as_flattened().iter().map(|v| *v as f32).collect();
    let net = Graph::default()
        .input("image", Element::Uint8, &[1, side, side, 3])
        .constant(Tensor::floats("right", &[1, 8, 2], &pixels))
        .constant(Tensor::floats("zero", &[], &[0.0]))
        .node(Node::cast("image", "floats", Element::Float))
        .node(Node::new("ReduceMax", &["floats"], "brightest").with(Attribute::integer("keepdims", 0)))
        .node(Node::new("Div", &["zero", "brightest"], "zero_or_none"))
        .node(Node::new("Add", &["right", "zero_or_none"], "keypoints"))
        .output("keypoints", Element::Float)
        .answer(Tensor::floats("peaks", &[1, 8], &[0.9; 8]))
        .answer(Tensor::floats("covariances", &[1, 8, 2, 2], &[0.1, 0.0, 0.0, 0.1].repeat(8)));
    let detector = Graph::default()
        .input("images", Element::Uint8, &[1, i64::from(HEIGHT), i64::from(WIDTH), 3])
        .answer(Tensor::floats("detections", &[1, 1, 6], &[x1, y1, x2, y2, 0.9, 0.0]));
    let mut estimator = start_with(&Manifests::default(), detector, net).unwrap();
    let (images, camera) = ([image(50), RgbImage::new(WIDTH, HEIGHT), image(60)], camera());
    let frames: Vec<Frame<'_>> = images.iter().map(|image| Frame::new(image, &camera)).collect();
    let answers = estimator.estimate_all(&frames);
    assert_right(answers[0].as_ref().unwrap());
    assert_right(answers[2].as_ref().unwrap());
    let [black] = &answers[1].as_ref().unwrap().poses[..] else { panic!("one box, one answer") };
    assert!(black.pose.is_none() && black.verdict.reasons.contains(Reason::NotFinite));
}

/// In 16-bit floats both ways; the score is the largest value of the input.
#[test]
fn half_precision_goes_in_and_comes_out() {
    let mut manifests = Manifests::default();
    manifests.detector["input"] =
        json!({"layout": "nchw", "dtype": "float16", "width": WIDTH, "height": HEIGHT, "fill": 0});
    let [x1, y1, x2, y2] = corners();
    let detector = Graph::default()
        .input("images", Element::Half, &[1, 3, i64::from(HEIGHT), i64::from(WIDTH)])
        .constant(Tensor::floats("box", &[1, 1, 6], &[x1, y1, x2, y2, 0.0, 0.0]))
        .constant(Tensor::floats("at_score", &[1, 1, 6], &[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]))
        .node(Node::cast("images", "floats", Element::Float))
        .node(Node::new("ReduceMax", &["floats"], "brightest").with(Attribute::integer("keepdims", 0)))
        .node(Node::new("Mul", &["brightest", "at_score"], "score"))
        .node(Node::new("Add", &["box", "score"], "rows"))
        .node(Node::cast("rows", "detections", Element::Half))
        .output("detections", Element::Half);
    let mut estimator = start(&manifests, detector).unwrap();
    let [bright, dim] = [[255, 90, 20], [50, 40, 20]].map(|rgb| RgbImage::from_pixel(WIDTH, HEIGHT, image::Rgb(rgb)));
    let answer = estimator.estimate(&bright, &camera()).unwrap();
    assert_right(&answer);
    assert!((answer.poses[0].detection.score - 1.0).abs() < 1e-3);
    assert!(estimator.estimate(&dim, &camera()).unwrap().poses.is_empty());
}

/// As RT-DETR and D-FINE: a second input with the image's size, and boxes in pixels of it.
fn with_size_input() -> Graph {
    let [x1, y1, x2, y2] = corners();
    let (width, height) = (WIDTH as f32, HEIGHT as f32);
    Graph::default()
        .input("images", Element::Uint8, &[1, i64::from(HEIGHT), i64::from(WIDTH), 3])
        .input("orig_target_sizes", Element::Int64, &[1, 2])
        .constant(Tensor::floats("shares", &[1, 1, 4], &[x1 / width, y1 / height, x2 / width, y2 / height]))
        .constant(Tensor::int64s("twice", &[2], &[1, 2]))
        .node(Node::cast("orig_target_sizes", "size", Element::Float))
        .node(Node::new("Tile", &["size", "twice"], "sizes"))
        .node(Node::new("Mul", &["shares", "sizes"], "boxes"))
        .answer(Tensor::int64s("labels", &[1, 1], &[0]))
        .output("boxes", Element::Float)
        .answer(Tensor::floats("scores", &[1, 1], &[0.9]))
}

#[test]
fn the_size_of_the_image_is_an_input_where_it_is_stated() {
    let mut manifests = Manifests::default();
    manifests.detector["format"] = "torchvision".into();
    manifests.detector["input"]["size_input"] = "orig_target_sizes".into();
    let mut estimator = start(&manifests, with_size_input()).unwrap();
    assert_right(&estimator.estimate(&image(50), &camera()).unwrap());
    // An image of half the size: its boxes too.
    let small = RgbImage::from_pixel(WIDTH / 2, HEIGHT / 2, image::Rgb([50; 3]));
    let region = estimator.estimate(&small, &camera()).unwrap().poses[0].detection.bounding_box;
    assert!((region.x - BOX[0] / 2.0).abs() < 0.1 && (region.height - BOX[3] / 2.0).abs() < 0.1, "{region:?}");

    for (stated, words) in
        [(json!(null), "[\"images\", \"orig_target_sizes\"]"), (json!("sizes"), "no input \"sizes\"")]
    {
        manifests.detector["input"]["size_input"] = stated;
        let refusal = start(&manifests, with_size_input()).err().unwrap();
        assert!(refusal.contains(words) && refusal.contains("'input.size_input'"), "{refusal}");
    }
}

/// Counts and classes as 32-bit integers; what lies behind the count is of another image.
#[test]
fn efficient_nms_is_read() {
    let mut manifests = Manifests::default();
    manifests.detector["format"] = "efficient_nms".into();
    let boxes = [corners(), [10.0, 10.0, 60.0, 60.0], [f32::NAN; 4]];
    let detector = |count: i32| {
        Graph::default()
            .input("images", Element::Uint8, &[1, i64::from(HEIGHT), i64::from(WIDTH), 3])
            .answer(Tensor::int32s("num_dets", &[1, 1], &[count]))
            .answer(Tensor::floats("det_boxes", &[1, 3, 4], boxes.as_flattened()))
            .answer(Tensor::floats("det_scores", &[1, 3], &[0.9; 3]))
            .answer(Tensor::int32s("det_classes", &[1, 3], &[0; 3]))
    };
    assert_right(&start(&manifests, detector(1)).unwrap().estimate(&image(50), &camera()).unwrap());
    let two = start(&manifests, detector(2)).unwrap().estimate(&image(50), &camera()).unwrap();
    assert_eq!(two.poses.len(), 2);
    let refusal = start(&manifests, detector(4)).err().unwrap();
    assert!(refusal.contains("'num_dets' is [4.0] beside 3 boxes"), "{refusal}");
}

/// An output that is needed and is no tensor of numbers is named.
#[test]
fn a_needed_output_of_another_type_is_named() {
    let mut manifests = Manifests::default();
    manifests.detector["format"] = "torchvision".into();
    let detector = Graph::default()
        .input("images", Element::Uint8, &[1, i64::from(HEIGHT), i64::from(WIDTH), 3])
        .answer(Tensor::floats("boxes", &[1, 4], &corners()))
        .answer(Tensor::strings("labels", &["block"]))
        .answer(Tensor::floats("scores", &[1], &[0.9]));
    let refusal = start(&manifests, detector).err().unwrap();
    assert!(refusal.contains("'labels' is no tensor of numbers"), "{refusal}");
}
