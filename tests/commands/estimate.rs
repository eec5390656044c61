//! `posed estimate` and `posed check`.

use std::fs;

use posed_core::geometry::Pose;
use serde_json::Value;

use crate::support::{assert_right, copy_of, explanation, run, samples};

#[test]
fn estimate_answers_every_sample_and_draws_it() {
    for sample in samples() {
        let folder = tempfile::tempdir().unwrap();
        let overlay = folder.path().join("overlay.png");
        let image = sample.file.to_str().unwrap();
        let arguments = ["estimate", image, "--camera", "samples/demo.camera.json", "--json", "--overlay"];
        let output = run(&[&arguments[..], &[overlay.to_str().unwrap()]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_right(&sample, &answer);
        let (drawn, plain) = (image::open(overlay).unwrap().into_rgb8(), image::open(image).unwrap().into_rgb8());
        assert_eq!(drawn.dimensions(), plain.dimensions());
        let changed = drawn.pixels().zip(plain.pixels()).filter(|(a, b)| a != b).count();
        assert!(changed > 200, "{changed} pixels drawn");
    }
}

/// Of the poses that look alike the answer is always the same one.
#[test]
fn a_symmetric_object_gets_its_canonical_pose() {
    let half_turns = [[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
        .map(|[x, y, z]| [x, 0.0, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, 0.0, z, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let models = copy_of("models");
    let manifest = models.path().join("cube/object.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&manifest).unwrap()).unwrap();
    json["symmetries_discrete"] = serde_json::to_value(half_turns).unwrap();
    fs::write(&manifest, json.to_string()).unwrap();
    let cube = |models: &str, image: &str| {
        let output = run(&["estimate", image, "--camera", "samples/demo.camera.json", "--json", "--models", models]);
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        let found = answer["poses"].as_array().unwrap().iter().find(|pose| pose["object"] == "cube").unwrap().clone();
        let numbers: [f64; 4] = serde_json::from_value(found["camera_from_object"]["rotation_xyzw"].clone()).unwrap();
        Pose::from_quaternion_xyzw(numbers, [0.0; 3]).unwrap()
    };
    let mut changed = 0;
    for sample in samples() {
        let image = sample.file.to_str().unwrap();
        let (plain, canonical) = (cube("models", image), cube(models.path().to_str().unwrap(), image));
        let alike = half_turns.map(|m| plain * Pose::from_matrix(&nalgebra::Matrix4::from_row_slice(&m)).unwrap());
        let nearest = alike.into_iter().chain([plain]).map(|pose| pose.angle_to(&Pose::identity())).fold(4.0, f64::min);
        assert!((canonical.angle_to(&Pose::identity()) - nearest).abs() < 1e-3);
        assert!(alike.iter().chain([&plain]).any(|pose| pose.angle_to(&canonical) < 1e-3));
        changed += usize::from(plain.angle_to(&canonical) > 0.1);
    }
    assert!(changed > 0, "every sample shows the cube's canonical pose, so this test shows nothing");
}

#[test]
fn estimate_says_which_file_is_wrong() {
    let camera = "samples/demo.camera.json";
    let missing = run(&["estimate", "nowhere.jpg", "--camera", camera]);
    assert!(explanation(&missing).contains("nowhere.jpg"));
    let no_image = run(&["estimate", camera, "--camera", camera]);
    assert!(explanation(&no_image).contains("JPEG, PNG or WebP"));
    let no_camera = run(&["estimate", samples()[0].file.to_str().unwrap(), "--camera", "samples/poses.json"]);
    assert!(explanation(&no_camera).contains("samples/poses.json"));
}

#[test]
fn check_compares_the_samples_with_their_known_poses() {
    let output = run(&["check"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    let known: usize = samples().iter().map(|sample| sample.objects.len()).sum();
    assert!(text.contains(&format!("{known} of {known} poses are right")), "{text}");

    let moved = copy_of("samples");
    let path = moved.path().join("poses.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    json["sample-1.jpg"][0]["translation_m"][2] = 0.9.into();
    fs::write(&path, json.to_string()).unwrap();
    let said = explanation(&run(&["check", "--samples", moved.path().to_str().unwrap()]));
    assert!(said.contains(&format!("1 of {known} poses")), "{said}");
}

/// A frame as a camera's driver gives it gets the poses of the same pixels as PNG.
#[test]
fn estimate_takes_raw_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let pixels = image::open(&samples()[0].file).unwrap().into_rgb8();
    pixels.save(path("frame.png")).unwrap();
    let (width, height) = pixels.dimensions();
    let rows = pixels.rows().map(|row| row.flat_map(|pixel| [pixel[2], pixel[1], pixel[0]]).collect::<Vec<u8>>());
    fs::write(path("frame.raw"), rows.flat_map(|row| [row, vec![200; 24]].concat()).collect::<Vec<u8>>()).unwrap();
    let layout = format!("bgr8:{width}x{height}:{}", 3 * width + 24);
    let estimate = |name: &str, extra: &[&str]| {
        run(&[&["estimate", &path(name), "--camera", "samples/demo.camera.json", "--json"], extra].concat())
    };
    let poses = |name: &str, extra: &[&str]| {
        let output = estimate(name, extra);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        answer["poses"].clone()
    };
    let raw = poses("frame.raw", &["--raw", &layout]);
    assert!(!raw.as_array().unwrap().is_empty());
    assert_eq!(raw, poses("frame.png", &[]));

    let without_padding = estimate("frame.raw", &["--raw", &format!("bgr8:{width}x{height}")]);
    let said = explanation(&without_padding);
    assert!(said.contains("frame.raw") && said.contains("'step'"), "{said}");
    let said = explanation(&estimate("frame.raw", &["--raw", "bgr9:640x480"]));
    assert!(said.contains("bgr9") && said.contains("bgr8"), "{said}");
}

/// The part of a name after its last point is not always an ending, and two images are never drawn to one file.
#[test]
fn every_image_has_a_picture_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let image = |name: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::copy(&samples()[0].file, &path).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let out = folder.path().join("out");
    let draw = |first: &str, second: &str| {
        let [first, second] = [first, second].map(image);
        let arguments = ["estimate", &first, &second, "--camera", "samples/demo.camera.json", "--overlay"];
        run(&[&arguments[..], &[out.to_str().unwrap()]].concat())
    };
    assert!(draw("cam.0001.jpg", "cam.0002.jpg").status.success());
    let mut made: Vec<_> = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    made.sort();
    assert_eq!(made, ["cam.0001.png", "cam.0002.png"]);
    assert!(explanation(&draw("left/1.jpg", "right/1.jpg")).contains("different names"));
}

/// Boxes of a file in place of the detector's: for one image a list, for several a list each.
#[test]
fn estimate_takes_boxes_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("boxes.json");
    let camera = "samples/demo.camera.json";
    let all = samples();
    let estimate =
        |images: &[&str], more: &[&str]| run(&[&["estimate"], images, &["--camera", camera, "--json"], more].concat());
    let with_boxes = |images: &[&str], boxes: &Value| {
        fs::write(&file, boxes.to_string()).unwrap();
        estimate(images, &["--boxes", file.to_str().unwrap()])
    };
    let image = all[0].file.to_str().unwrap();
    let detected: Value = serde_json::from_slice(&estimate(&[image], &[]).stdout).unwrap();
    let boxes: Vec<Value> = detected["poses"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pose| serde_json::json!({"object": pose["object"], "box_px": pose["detection"]["box_px"]}))
        .collect();
    let answer: Value = serde_json::from_slice(&with_boxes(&[image], &boxes.clone().into()).stdout).unwrap();
    assert_right(&all[0], &answer);
    assert!(answer["poses"].as_array().unwrap().iter().all(|pose| pose["detection"]["given_box"].is_number()));

    let second = all[1].file.to_str().unwrap();
    let name = |file: &str| std::path::Path::new(file).file_name().unwrap().to_str().unwrap().to_owned();
    let by_image = serde_json::json!({name(image): boxes, name(second): []});
    let output = with_boxes(&[image, second], &by_image);
    let lines: Vec<Value> = output
        .stdout
        .split(|byte| *byte == b'\n')
        .filter(|line| !line.is_empty())
        .map(|line| serde_json::from_slice(line).unwrap())
        .collect();
    let counts: Vec<_> = lines.iter().map(|answer| answer["poses"].as_array().unwrap().len()).collect();
    assert_eq!(counts, [boxes.len(), 0]);
    let one = |object: &str, box_px: Value| serde_json::json!([{"object": object, "box_px": box_px}]);
    for (images, boxes, words) in [
        (&[image][..], one("teapot", serde_json::json!([0, 0, 50, 50])), "unknown object \"teapot\""),
        (&[image], one("cube", serde_json::json!([0, 0, 50])), "boxes.json"),
        (&[image], one("cube", serde_json::json!([900, 0, 50, 50])), "boxes[0]"),
        (&[image], serde_json::json!(3), "a list of boxes"),
        (&[image, second], serde_json::json!(boxes), "a list for each file name"),
        (&[image], serde_json::json!({"other.jpg": []}), "no entry \"sample-1.jpg\""),
    ] {
        let said = explanation(&with_boxes(images, &boxes));
        assert!(said.contains(words), "{words}: {said}");
    }
}
