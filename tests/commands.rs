//! The commands of the real program: what they do, and what they say when something is wrong.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod support;

use std::fs;
use std::net::TcpListener;

use posed_core::geometry::Pose;
use serde_json::Value;
use support::{FREE_PORTS, assert_right, assert_within, copy_of, explanation, root, run, samples};

const SCENE: &str = "tests/data/scene";

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

/// A calibration on an image that is not among the shipped references works, too.
#[test]
fn calibrate_makes_a_reference_that_works() {
    let reference = tempfile::tempdir().unwrap();
    let folder = reference.path().to_str().unwrap();
    for object in ["cube", "bracket", "motor", "link"] {
        let output = run(&["calibrate", object, "--scene", SCENE, "--image", "0", "--reference", folder]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(reference.path().join(format!("{object}.jpg")).is_file());
    }
    let sample = &samples()[0];
    let image = sample.file.to_str().unwrap();
    let output = run(&["estimate", image, "--camera", "samples/demo.camera.json", "--json", "--reference", folder]);
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    // This reference image shows the objects smaller than the shipped ones do, so its offset is less exact.
    assert_within(sample, &answer, 0.25);
}

/// A scene of the same image several times; its objects' stated poses are shifted by these lengths (mm).
fn scene_with_shifts(shifts: &[f64]) -> tempfile::TempDir {
    let folder = copy_of(SCENE);
    let change = |name: &str, edit: &dyn Fn(Value, f64) -> Value| {
        let path = folder.path().join(name);
        let entries: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        let all: serde_json::Map<String, Value> =
            shifts.iter().enumerate().map(|(id, shift)| (id.to_string(), edit(entries["0"].clone(), *shift))).collect();
        fs::write(path, serde_json::to_vec(&all).unwrap()).unwrap();
    };
    for name in ["scene_camera.json", "scene_gt_info.json"] {
        change(name, &|entry, _| entry);
    }
    change("scene_gt.json", &|mut entry, shift| {
        for object in entry.as_array_mut().unwrap() {
            let x = object["cam_t_m2c"][0].as_f64().unwrap();
            object["cam_t_m2c"][0] = (x + shift).into();
        }
        entry
    });
    for id in 1..shifts.len() {
        let rgb = folder.path().join("rgb");
        fs::copy(rgb.join("000000.jpg"), rgb.join(format!("{id:06}.jpg"))).unwrap();
    }
    folder
}

#[test]
fn calibrate_leaves_out_a_wrong_reference() {
    let reference = tempfile::tempdir().unwrap();
    let folder = reference.path().to_str().unwrap();
    let calibrate = |shifts: &[f64], mode: &str| {
        let scene = scene_with_shifts(shifts);
        let ids: Vec<_> = (0..shifts.len()).map(|id| id.to_string()).collect();
        let images = ids.iter().flat_map(|id| ["--image", id]);
        let scene = scene.path().to_str().unwrap();
        let common = ["calibrate", "cube", "--scene", scene, "--reference", folder, "--mode", mode];
        run(&common.into_iter().chain(images).collect::<Vec<_>>())
    };
    for mode in ["paper", "weighted"] {
        let output = calibrate(&[0.0, 200.0, 4.0], mode);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let file = fs::read(reference.path().join("cube.json")).unwrap();
        let made: Value = serde_json::from_slice(&file).unwrap();
        assert_eq!(made["method"], mode);
        let inliers: Vec<_> = made["references"].as_array().unwrap().iter().map(|r| r["inlier"].clone()).collect();
        assert_eq!(inliers, [true, false, true]);
        // Both good ones are 2 mm from their mean.
        assert!((made["references"][0]["residual_mm"].as_f64().unwrap() - 2.0).abs() < 0.01);
        assert!(reference.path().join("cube-2.jpg").is_file());
    }
    assert!(explanation(&calibrate(&[0.0, 200.0], "weighted")).contains("1 of 2 references agree"));
}

/// On the only image of a split: with the true pose as the reference of that very image, the answer is right; with the
/// shipped references it is scored in the same way, by ground-truth boxes and by the detector's.
#[test]
fn evaluate_scores_a_split() {
    let split = tempfile::tempdir().unwrap();
    fs::rename(copy_of(SCENE).keep(), split.path().join("000000")).unwrap();
    let reference = tempfile::tempdir().unwrap();
    let folder = reference.path().to_str().unwrap();
    assert!(run(&["calibrate", "cube", "--scene", SCENE, "--image", "0", "--reference", folder]).status.success());
    let evaluate = |extra: &[&str]| {
        let common =
            ["evaluate", "cube", "--split", split.path().to_str().unwrap(), "--meshes", "training/demo/models"];
        run(&[&common[..], extra].concat())
    };
    let row = |extra: &[&str]| {
        let output = evaluate(extra);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().last().unwrap().split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(row(&["--reference", folder])[1..8], ["cube", "1", "100.0", "100.0", "100.0", "0.00", "0.0"]);
    for extra in [&[][..], &["--detector"][..]] {
        let cells = row(extra);
        assert_eq!(cells[1..3], ["cube", "1"]);
        let rotation_deg: f64 = cells[6].parse().unwrap();
        assert!(rotation_deg > 0.0 && rotation_deg < 30.0, "{rotation_deg}");
    }
    assert!(explanation(&evaluate(&["--max-visible", "0.1", "--min-visible", "0"])).contains("no view of cube"));
}

#[test]
fn calibrate_refuses_what_is_not_there() {
    let reference = tempfile::tempdir().unwrap();
    let folder = reference.path().to_str().unwrap();
    let attempt = |object: &str, scene: &str, image: &str| {
        explanation(&run(&["calibrate", object, "--scene", scene, "--image", image, "--reference", folder]))
    };
    assert!(attempt("cube", SCENE, "7").contains("no image 7"));
    assert!(attempt("cube", "samples", "0").contains("scene_camera.json"));
    assert!(attempt("teapot", SCENE, "0").contains("teapot"));
    assert_eq!(fs::read_dir(reference.path()).unwrap().count(), 0, "nothing half-written");
}

/// `serve` refuses to start, with these words.
fn refuses_to_serve(arguments: &[&str], words: &str) {
    let said = explanation(&run(&[&["serve"], &FREE_PORTS[..], arguments].concat()));
    assert!(said.contains(words), "{said}");
}

#[test]
fn damaged_models_are_named() {
    let damage = |file: &str, change: &dyn Fn(&mut Vec<u8>), words: &str| {
        let models = copy_of("models");
        let path = models.path().join(file);
        let mut bytes = fs::read(&path).unwrap();
        change(&mut bytes);
        fs::write(&path, bytes).unwrap();
        refuses_to_serve(&["--models", models.path().to_str().unwrap()], words);
    };
    damage("cube/keypoints.onnx", &|bytes| bytes[1000] ^= 0xFF, "sha256");
    damage("detector/detector.onnx", &|bytes| bytes.truncate(5000), "sha256");
    damage("cube/object.json", &|bytes| bytes.truncate(60), "cube/object.json");
    let replace = |from: &'static str, to: &'static str| {
        move |bytes: &mut Vec<u8>| *bytes = String::from_utf8_lossy(bytes).replace(from, to).into_bytes()
    };
    damage("cube/object.json", &replace("\"crop_scale\": 1.5", "\"crop_scale\": 1e9"), "'crop_scale'");
    damage("cube/object.json", &replace("\"name\": \"cube\"", "\"name\": \"../cube\""), "'name'");
    damage("cube/object.json", &replace("\"obj_id\"", "\"id\""), "`id`");
    let sheared = "\"symmetries_discrete\": [[1,1,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]], \"crop_scale\"";
    damage("cube/object.json", &replace("\"crop_scale\"", sheared), "'symmetries_discrete'");
    damage("detector/detector.json", &replace("end2end", "yolov99"), "yolov99");
    // Formats cannot be told apart by the file: the warm-up finds a wrong one before anybody waits.
    damage("detector/detector.json", &replace("end2end", "yolov8"), "has shape");
    damage("cube/object.json", &replace("\"kind\": \"keypoints\"", "\"kind\": \"heatmaps\""), "has shape");
}

#[test]
fn a_file_that_is_no_network_is_named() {
    let models = copy_of("models");
    let network = models.path().join("cube/keypoints.onnx");
    fs::write(&network, b"this is not a network").unwrap();
    let manifest = models.path().join("cube/object.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&manifest).unwrap()).unwrap();
    // sha256 of the text above, so that the check of the hash passes.
    json["model_sha256"] = "c7b0c3ac7fbf1d2cc8ba2e4cd5d2d0ff6ef3a8b2b8f2f8f3c9a8e3a4d5b6c7d8".into();
    fs::write(&manifest, json.to_string()).unwrap();
    let folder = models.path().to_str().unwrap();
    let said = explanation(&run(&[&["serve"], &FREE_PORTS[..], &["--models", folder]].concat()));
    let found = said.split("has sha256 ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap().to_owned();
    json["model_sha256"] = found.into();
    fs::write(&manifest, json.to_string()).unwrap();
    let none = tempfile::tempdir().unwrap();
    refuses_to_serve(&["--models", folder, "--reference", none.path().to_str().unwrap()], "cannot load this network");
}

#[test]
fn missing_models_are_named() {
    refuses_to_serve(&["--models", "nowhere"], "nowhere/detector/detector.json");
    let models = copy_of("models");
    fs::remove_file(models.path().join("cube/keypoints.onnx")).unwrap();
    refuses_to_serve(&["--models", models.path().to_str().unwrap()], "cube/keypoints.onnx");
}

#[test]
fn a_reference_for_another_model_is_refused() {
    let reference = copy_of("reference");
    let path = reference.path().join("cube.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    json["keypoint_model_sha256"] = "0".repeat(64).into();
    fs::write(&path, json.to_string()).unwrap();
    refuses_to_serve(&["--reference", reference.path().to_str().unwrap()], "posed calibrate cube");
}

#[test]
fn a_port_in_use_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for flag in ["--http", "--grpc", "--admin"] {
        let ports: Vec<&str> = ["--http", "--grpc", "--admin"]
            .into_iter()
            .flat_map(|port| [port, if port == flag { &address } else { "127.0.0.1:0" }])
            .collect();
        let said = explanation(&run(&[&["serve"], &ports[..]].concat()));
        assert!(said.contains(&address) && said.contains(flag), "{said}");
    }
}

#[test]
fn a_missing_runtime_is_explained() {
    let output = support::posed(&["serve"])
        .args(FREE_PORTS)
        .env("ORT_DYLIB_PATH", "/nowhere/libonnxruntime.so")
        .output()
        .unwrap();
    let said = explanation(&output);
    assert!(said.contains("/nowhere/libonnxruntime.so") && said.contains("make onnxruntime"), "{said}");
    let wrong = root().join("Cargo.toml");
    let output = support::posed(&["serve"]).args(FREE_PORTS).env("ORT_DYLIB_PATH", wrong).output().unwrap();
    assert!(explanation(&output).contains("not a usable ONNX Runtime library"));
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

#[test]
fn the_printed_settings_are_a_file_of_settings_and_wrong_ones_are_refused() {
    let printed = String::from_utf8(run(&["serve", "--print-config"]).stdout).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("posed.toml");
    let with_file = |text: &str, words: &str| {
        fs::write(&path, text).unwrap();
        refuses_to_serve(&["--config", path.to_str().unwrap(), "--timeout-ms", "90000"], words);
    };
    // Wrong only in the flag beside it.
    with_file(&printed, "'timeout_ms' is 90000: more than a request may ask for ('max_timeout_ms', 60000)");
    let name = path.to_str().unwrap();
    with_file(&format!("{printed}\nquue = 3\n"), &format!("{name}: there is no setting 'quue'; 'queue' is one"));
    with_file("queue = 0", &format!("{name}: setting 'queue' is 0: it must be a whole number from 1 to 65536"));
    let said = explanation(&support::posed(&["serve", "--print-config"]).env("POSED_QUEUE", "many").output().unwrap());
    assert!(said.contains("'many' for '--queue <QUEUE>'") && said.contains("from 1 to 65536"), "{said}");
    refuses_to_serve(&["--config", "nowhere.toml"], "cannot read nowhere.toml");
    refuses_to_serve(&["--provider", "cuda"], "'cuda'");
}

/// Seen in what is said of two settings that contradict each other.
#[test]
fn flags_win_over_the_environment_the_environment_over_the_file_and_the_file_over_the_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("posed.toml");
    let timeouts = |file: &str, environment: &[(&str, &str)], flags: &[&str], expected: [u32; 2]| {
        fs::write(&path, file).unwrap();
        let by_flag = support::posed(&["serve", "--config", path.to_str().unwrap()]);
        let mut by_environment = support::posed(&["serve"]);
        by_environment.env("POSED_CONFIG", &path);
        for mut command in [by_flag, by_environment] {
            let output = command.args(FREE_PORTS).envs(environment.iter().copied()).args(flags).output().unwrap();
            let [timeout, longest] = expected;
            let words =
                format!("'timeout_ms' is {timeout}: more than a request may ask for ('max_timeout_ms', {longest})");
            let said = explanation(&output);
            assert!(said.contains(&words), "{said}");
        }
    };
    let (file, environment) = ("max_timeout_ms = 5\n", [("POSED_TIMEOUT_MS", "200")]);
    timeouts(file, &[], &[], [10_000, 5]);
    timeouts(&format!("{file}timeout_ms = 100\n"), &[], &[], [100, 5]);
    timeouts(&format!("{file}timeout_ms = 100\n"), &environment, &[], [200, 5]);
    timeouts(&format!("{file}timeout_ms = 100\n"), &environment, &["--timeout-ms", "300"], [300, 5]);
}

#[test]
fn completions_know_the_sub_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let text = String::from_utf8(run(&["completions", shell]).stdout).unwrap();
        assert!(text.contains("healthcheck") && text.contains("calibrate"));
    }
}

/// Known poses as JSON, and points clicked in two images, give the offset that the BOP scene gives.
#[test]
fn calibrate_takes_known_poses_and_clicks() {
    let scene = copy_of(SCENE);
    let read = |name: &str| -> Value { serde_json::from_slice(&fs::read(scene.path().join(name)).unwrap()).unwrap() };
    let k: Vec<f64> = serde_json::from_value(read("scene_camera.json")["0"]["cam_K"].clone()).unwrap();
    let (truths, infos) = (read("scene_gt.json")["0"].clone(), read("scene_gt_info.json")["0"].clone());
    let index = truths.as_array().unwrap().iter().position(|truth| truth["obj_id"] == 1).unwrap();
    let row_major: Vec<f64> = serde_json::from_value(truths[index]["cam_R_m2c"].clone()).unwrap();
    let millimetres: Vec<f64> = serde_json::from_value(truths[index]["cam_t_m2c"].clone()).unwrap();
    let mut matrix = nalgebra::Matrix4::identity();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&nalgebra::Matrix3::from_row_slice(&row_major));
    (0..3).for_each(|axis| matrix[(axis, 3)] = 1e-3 * millimetres[axis]);
    let camera_from_object = Pose::from_matrix(&matrix).unwrap();
    let camera = serde_json::json!({"model": "pinhole", "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5]});
    let pose =
        |pose: &Pose| serde_json::json!({"rotation_xyzw": pose.rotation_xyzw(), "translation_m": pose.translation_m()});
    let (image, box_px) = ("rgb/000000.jpg", infos[index]["bbox_visib"].clone());

    let known = serde_json::json!([
        {"image": image, "camera": camera, "camera_from_object": pose(&camera_from_object), "box_px": box_px}
    ]);
    // A second camera, 15 degrees to the side; the clicks are exact.
    let second_from_first = Pose::from_quaternion_xyzw([0.0, 0.1305, 0.0, 0.9914], [-0.18, 0.01, 0.02]).unwrap();
    let lens = posed_core::geometry::Camera::pinhole(k[0], k[4], k[2], k[5]).unwrap();
    let points = [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.03], [0.03, 0.03, 0.01]];
    let clicks: Vec<Value> = points
        .iter()
        .map(|point| {
            let in_first = camera_from_object.transform(&nalgebra::Vector3::from(*point));
            let pixel = |point| lens.project(&point).unwrap();
            let (first, second) = (pixel(in_first), pixel(second_from_first.transform(&in_first)));
            serde_json::json!({"first_px": [first.x, first.y], "second_px": [second.x, second.y]})
        })
        .collect();
    let clicked = serde_json::json!({
        "image": image, "first_camera": camera, "second_camera": camera, "clicks": clicks, "box_px": box_px,
        "second_from_first": pose(&second_from_first), "frame": {"origin": 0, "on_x": 1, "in_xy": 2},
    });
    let offset = |source: &[&str]| -> Pose {
        let reference = tempfile::tempdir().unwrap();
        let folder = reference.path().to_str().unwrap();
        let output = run(&[&["calibrate", "cube", "--reference", folder], source].concat());
        let text = String::from_utf8(output.stdout.clone()).unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(text.contains("view from the side"), "one view knows its depth least: {text}");
        let file = fs::read(reference.path().join("cube.json")).unwrap();
        let made: Value = serde_json::from_slice(&file).unwrap();
        let offset = &made["object_from_keypoints"];
        let rotation = serde_json::from_value(offset["rotation_xyzw"].clone()).unwrap();
        Pose::from_quaternion_xyzw(rotation, serde_json::from_value(offset["translation_m"].clone()).unwrap()).unwrap()
    };
    let write = |name: &str, json: &Value| {
        let path = scene.path().join(name);
        fs::write(&path, json.to_string()).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let of_scene = offset(&["--scene", scene.path().to_str().unwrap(), "--image", "0"]);
    for made in [
        offset(&["--references", &write("known.json", &known)]),
        offset(&["--clicks", &write("clicks.json", &clicked)]),
    ] {
        assert!(made.angle_to(&of_scene) < 1e-3, "{made:?} {of_scene:?}");
        assert!((made.translation() - of_scene.translation()).norm() < 1e-4, "{made:?} {of_scene:?}");
    }
    let misspelt = write("known.json", &serde_json::json!([{"image": image, "kamera": camera}]));
    assert!(explanation(&run(&["calibrate", "cube", "--references", &misspelt])).contains("kamera"));
    assert!(explanation(&run(&["calibrate", "cube"])).contains("--scene"));
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
