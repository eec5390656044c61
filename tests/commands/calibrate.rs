//! `posed calibrate` and `posed evaluate`.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use posed_core::geometry::Pose;
use serde_json::{Value, json};

use crate::SCENE;
use crate::clicked::ClickedCube;
use crate::support::{assert_within, copy_of, explanation, posed, root, run, samples};

/// A calibration on an image that is not among the shipped references works, too.
#[test]
fn calibrate_makes_a_reference_that_works() {
    let reference = tempfile::tempdir().unwrap();
    let folder = reference.path().to_str().unwrap();
    for object in ["cube", "bracket", "motor", "link"] {
        let output = run(&["calibrate", object, "--scene", SCENE, "--image", "0", "--reference", folder]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let image = &reference_file(reference.path(), object)["references"][0]["image"];
        assert!(reference.path().join(image.as_str().unwrap()).is_file());
    }
    let sample = &samples()[0];
    let image = sample.file.to_str().unwrap();
    let output = run(&["estimate", image, "--camera", "samples/demo.camera.json", "--json", "--reference", folder]);
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    // This reference image shows the objects smaller than the shipped ones do, so its offset is less exact.
    assert_within(sample, &answer, 0.25);
}

fn reference_file(folder: &Path, object: &str) -> Value {
    serde_json::from_slice(&fs::read(folder.join(format!("{object}.json"))).unwrap()).unwrap()
}

/// Each mistake that people make with poses is refused with what it looks like; nothing is written.
#[test]
fn calibrate_guesses_what_is_wrong_with_a_pose() {
    let folder = tempfile::tempdir().unwrap();
    let reference = folder.path().join("reference");
    let image = fs::canonicalize(Path::new(SCENE).join("rgb/000000.jpg")).unwrap();
    let entry = |file: &str| -> Value {
        serde_json::from_slice::<Value>(&fs::read(Path::new(SCENE).join(file)).unwrap()).unwrap()["0"].take()
    };
    let truth = entry("scene_gt.json").as_array().unwrap().iter().find(|truth| truth["obj_id"] == 1).unwrap().clone();
    let index = entry("scene_gt.json").as_array().unwrap().iter().position(|truth| truth["obj_id"] == 1).unwrap();
    let box_px = entry("scene_gt_info.json")[index]["bbox_visib"].clone();
    let k: Vec<f64> = serde_json::from_value(entry("scene_camera.json")["cam_K"].clone()).unwrap();
    let camera = json!({"model": "pinhole", "fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5]});
    let numbers = |field: &str| serde_json::from_value::<Vec<f64>>(truth[field].clone()).unwrap();
    let metres: Vec<f64> = numbers("cam_t_m2c").iter().map(|mm| mm / 1e3).collect();
    let right = Pose::from_row_major(numbers("cam_R_m2c").try_into().unwrap(), metres.try_into().unwrap()).unwrap();
    let moved = |factor: f64, by: [f64; 3]| {
        let [x, y, z] = right.translation_m();
        Pose::from_quaternion_xyzw(right.rotation_xyzw(), [x * factor + by[0], y * factor + by[1], z * factor + by[2]])
            .unwrap()
    };
    let attempt = |poses: &[Pose], extra: &[&str]| {
        let entry = |pose: &Pose| {
            let stated = json!({"rotation_xyzw": pose.rotation_xyzw(), "translation_m": pose.translation_m()});
            json!({"image": image, "camera": camera, "camera_from_object": stated, "box_px": box_px})
        };
        let file = folder.path().join("known.json");
        fs::write(&file, json!(poses.iter().map(entry).collect::<Vec<_>>()).to_string()).unwrap();
        let (file, reference) = (file.to_str().unwrap(), reference.to_str().unwrap());
        run(&[&["calibrate", "cube", "--references", file, "--reference", reference], extra].concat())
    };
    for (poses, words) in [
        (vec![moved(1e3, [0.0; 3])], "in millimetres"),
        // Several that have the mistake in common do not agree, but that is not what is wrong with them.
        (vec![moved(1e3, [0.0; 3]), moved(1e3, [90.0, 0.0, 0.0])], "in millimetres"),
        (vec![right.inverse()], "object_from_camera"),
        (vec![moved(1.0, [0.2, 0.0, 0.0])], "another object or image"),
        (vec![moved(-1.0, [0.0; 3])], "another object or image"),
        (vec![right, right], "same pose"),
        (vec![right, moved(1.0, [2e-4, 0.0, 0.0])], "the same object in the same image"),
    ] {
        let message = explanation(&attempt(&poses, &[]));
        assert!(message.contains(words), "{words}: {message}");
        assert!(!reference.exists(), "something was written");
    }
    assert!(attempt(&[right], &[]).status.success());
    assert!(attempt(&[moved(1.0, [0.2, 0.0, 0.0])], &["--far-origin"]).status.success());
}

/// Who reads what a command prints may leave; what it was to write is written all the same.
#[test]
fn a_reference_is_written_for_a_reader_that_leaves() {
    let folder = tempfile::tempdir().unwrap();
    let reference = folder.path().join("reference");
    let arguments = ["calibrate", "cube", "--scene", SCENE, "--image", "0", "--reference", reference.to_str().unwrap()];
    let mut child = posed(&arguments).stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
    assert!(reference.join("cube.json").exists());
}

/// A scene of the same picture in several files that differ; its objects' stated poses are shifted by these lengths (mm).
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
        let mut bytes = fs::read(rgb.join("000000.jpg")).unwrap();
        bytes.push(u8::try_from(id).unwrap());
        fs::write(rgb.join(format!("{id:06}.jpg")), bytes).unwrap();
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
        let made = reference_file(reference.path(), "cube");
        assert_eq!(made["method"], mode);
        let inliers: Vec<_> = made["references"].as_array().unwrap().iter().map(|r| r["inlier"].clone()).collect();
        assert_eq!(inliers, [true, false, true]);
        // Both good ones are 2 mm from their mean.
        assert!((made["references"][0]["residual_mm"].as_f64().unwrap() - 2.0).abs() < 0.01);
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
        text.lines().nth(4).unwrap().split('|').skip(1).map(|cell| cell.trim().to_owned()).collect::<Vec<_>>()
    };
    let cells = row(&["--reference", folder]);
    assert_eq!(cells[..9], ["cube", "0.7..1", "1", "100.0", "100.0", "100.0", "100.0", "0.00", "0.0"]);
    for extra in [&[][..], &["--detector"][..]] {
        let cells = row(extra);
        assert_eq!((cells[0].as_str(), cells[2].as_str()), ("cube", "1"));
        let rotation_deg: f64 = cells[7].parse().unwrap();
        assert!(rotation_deg > 0.0 && rotation_deg < 30.0, "{rotation_deg}");
    }
    assert!(explanation(&evaluate(&["--visible", "0..0.1"])).contains("no view of cube"));
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

/// Known poses as JSON, and points clicked in two images, give the offset that the BOP scene gives.
#[test]
#[allow(clippy::too_many_lines, reason = "one story")]
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
        let made = reference_file(reference.path(), "cube");
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
    // As an answer has it: quaternion and matrix, or the matrix alone; a camera without a model is a pinhole.
    let rows: [[f64; 4]; 4] = std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]));
    let bare = serde_json::json!({"fx": k[0], "fy": k[4], "cx": k[2], "cy": k[5]});
    let with_pose = |stated: Value| serde_json::json!([{"image": image, "camera": bare, "camera_from_object": stated, "box_px": box_px}]);
    let mut both = pose(&camera_from_object);
    both["matrix"] = serde_json::json!(rows);
    for made in [
        offset(&["--references", &write("known.json", &known)]),
        offset(&["--references", &write("known.json", &with_pose(serde_json::json!({"matrix": rows})))]),
        offset(&["--references", &write("known.json", &with_pose(both.clone()))]),
        offset(&["--clicks", &write("clicks.json", &clicked)]),
        offset(&["--clicks", &write("clicks.json", &serde_json::json!([clicked]))]),
    ] {
        assert!(made.angle_to(&of_scene) < 1e-3, "{made:?} {of_scene:?}");
        assert!((made.translation() - of_scene.translation()).norm() < 1e-4, "{made:?} {of_scene:?}");
    }
    both["matrix"][0][3] = 1.into();
    for (stated, words) in [
        (both, "another pose"),
        (serde_json::json!({"rotation_xyzw": [0, 0, 0, 1]}), "needs 'rotation_xyzw' and 'translation_m', or 'matrix'"),
        (
            serde_json::json!({"matrix": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}),
            "'matrix' is not a pose",
        ),
    ] {
        let said = explanation(&run(&["calibrate", "cube", "--references", &write("known.json", &with_pose(stated))]));
        assert!(said.contains(words), "{words}: {said}");
    }
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut clicked = clicked.clone();
        change(&mut clicked);
        clicked
    };
    let millimetres = |clicked: &mut Value| {
        for value in clicked["second_from_first"]["translation_m"].as_array_mut().unwrap() {
            *value = (1e3 * value.as_f64().unwrap()).into();
        }
    };
    let slipped = |clicked: &mut Value| {
        let y = clicked["clicks"][3]["second_px"][1].as_f64().unwrap();
        clicked["clicks"][3]["second_px"][1] = (y + 20.0).into();
    };
    let one_image = |clicked: &mut Value| {
        for click in clicked["clicks"].as_array_mut().unwrap() {
            click["second_px"] = click["first_px"].clone();
        }
    };
    for (file, words) in [
        (changed(&millimetres), "'second_from_first' in millimetres? give metres"),
        (changed(&slipped), "click 3: its two rays miss each other"),
        (changed(&one_image), "they seem to be one image"),
        (changed(&|clicked| clicked["second_image"] = image.into()), "rgb/000000.jpg are the same image"),
        (serde_json::json!([clicked, clicked]), "rgb/000000.jpg are the same image"),
        (serde_json::json!([]), "no pair of images"),
    ] {
        let said = explanation(&run(&["calibrate", "cube", "--clicks", &write("clicks.json", &file)]));
        assert!(said.contains(words), "{words}: {said}");
    }
    let misspelt = write("known.json", &serde_json::json!([{"image": image, "kamera": camera}]));
    assert!(explanation(&run(&["calibrate", "cube", "--references", &misspelt])).contains("kamera"));
    assert!(explanation(&run(&["calibrate", "cube"])).contains("--scene"));
}

/// Two pairs of one scene make a reference of two views, each measured by itself.
#[test]
fn calibrate_takes_several_pairs_of_images() {
    let cube = ClickedCube::new();
    let views: Vec<String> = (1..=3)
        .map(|view| root().join(format!("samples/scene/view-{view}.jpg")).to_str().unwrap().to_owned())
        .collect();
    let box_of = |view: &str| {
        let output = run(&["estimate", view, "--camera", "samples/demo.camera.json", "--json"]);
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        let poses = answer["poses"].as_array().unwrap().clone();
        poses.iter().find(|pose| pose["object"] == "cube").unwrap()["detection"]["box_px"].clone()
    };
    let pair = |first: usize, second: usize| {
        let mut pair = cube.pair(first, second);
        pair["image"] = views[first].as_str().into();
        pair["second_image"] = views[second].as_str().into();
        pair["box_px"] = box_of(&views[first]);
        pair
    };
    let folder = tempfile::tempdir().unwrap();
    let (file, reference) = (folder.path().join("clicks.json"), folder.path().join("reference"));
    fs::write(&file, json!([pair(0, 1), pair(1, 2)]).to_string()).unwrap();
    let output =
        run(&["calibrate", "cube", "--clicks", file.to_str().unwrap(), "--reference", reference.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let made = reference_file(&reference, "cube");
    assert_eq!((&made["method"], made["references"].as_array().unwrap().len()), (&"weighted".into(), 2));
    cube.assert_right(&made["references"]);
}
