//! Several views of one scene: `posed estimate --rig`, `posed evaluate --views`, `posed calibrate --fit-scale`.

use std::fs;
use std::path::Path;

use nalgebra::Matrix3;
use posed_core::geometry::Pose;
use serde_json::{Map, Value, json};

use crate::support::{assert_scene_right, explanation, root, run, scene_poses};

const IMAGES: [&str; 3] = ["samples/scene/view-1.jpg", "samples/scene/view-2.jpg", "samples/scene/view-3.jpg"];
const RIG: &str = "samples/scene.rig.json";

fn estimate(extra: &[&str]) -> std::process::Output {
    run(&[&["estimate"], &IMAGES[..], &["--rig", RIG], extra].concat())
}

#[test]
fn estimate_fuses_the_images_of_a_rig() {
    let folder = tempfile::tempdir().unwrap();
    let overlay = folder.path().join("views.png");
    let output = estimate(&["--json", "--overlay", overlay.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_scene_right(&serde_json::from_slice(&output.stdout).unwrap(), 0.06);
    assert_eq!(image::image_dimensions(overlay).unwrap(), (1920, 480));
    let table = String::from_utf8(estimate(&[]).stdout).unwrap();
    assert!(table.lines().filter(|line| line.contains(" of 3 ")).count() >= 4, "{table}");
}

#[test]
fn estimate_says_what_is_wrong_with_a_rig() {
    let said = explanation(&run(&["estimate", IMAGES[0], "--rig", RIG]));
    assert!(said.contains("1 images for 3 cameras"), "{said}");
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("bad.rig.json");
    let pose = json!({"rotation_xyzw": [0, 0, 0, 1], "translation_m": [0, 0, 0]});
    let stretched = json!({"rotation_xyzw": [0, 0, 0, 2], "translation_m": [0, 0, 0]});
    let camera = json!({"model": "pinhole", "fx": 600.0, "fy": 600.0, "cx": 319.5, "cy": 239.5});
    let entry = |camera: &Value, pose: &Value| json!({"camera": camera, "rig_from_camera": pose});
    for (cameras, words) in [
        (vec![entry(&camera, &pose)], "at least two cameras"),
        (vec![entry(&camera, &pose), entry(&camera, &stretched)], "camera 1: field 'rig_from_camera' is not a pose"),
        (vec![entry(&json!("left"), &pose), entry(&camera, &pose)], "camera 0: there is no file left.camera.json"),
    ] {
        fs::write(&rig, json!({ "cameras": cameras }).to_string()).unwrap();
        let said = explanation(&run(&[&["estimate"], &IMAGES[..], &["--rig", rig.to_str().unwrap()]].concat()));
        assert!(said.contains(words), "{said}");
    }
    // Each camera sees the objects, but nowhere near where the others do.
    fs::copy(root().join(RIG), &rig).unwrap();
    fs::copy(root().join("samples/demo.camera.json"), folder.path().join("demo.camera.json")).unwrap();
    crate::support::change(&rig, |rig| {
        for camera in rig["cameras"].as_array_mut().unwrap() {
            for metres in camera["rig_from_camera"]["translation_m"].as_array_mut().unwrap() {
                *metres = (1e3 * metres.as_f64().unwrap()).into();
            }
        }
    });
    let said = explanation(&run(&[&["estimate"], &IMAGES[..], &["--rig", rig.to_str().unwrap()]].concat()));
    assert!(said.contains("in millimetres; give metres"), "{said}");
}

/// The bundled scene as a BOP scene with ground truth, in a split.
fn split() -> tempfile::TempDir {
    let split = tempfile::tempdir().unwrap();
    let scene = split.path().join("000001");
    fs::create_dir_all(scene.join("rgb")).unwrap();
    let read = |path: &str| serde_json::from_slice::<Value>(&fs::read(root().join(path)).unwrap()).unwrap();
    let pose = |value: &Value| {
        let rotation = serde_json::from_value(value["rotation_xyzw"].clone()).unwrap();
        Pose::from_quaternion_xyzw(rotation, serde_json::from_value(value["translation_m"].clone()).unwrap()).unwrap()
    };
    let bop = |pose: &Pose, rotation: &str, translation: &str| {
        let rows: Matrix3<f64> = pose.rotation().matrix().transpose();
        let mm: Vec<f64> = pose.translation_m().iter().map(|metres| 1e3 * metres).collect();
        json!({ rotation: rows.as_slice(), translation: mm })
    };
    let (rig, objects) = (read(RIG), read("samples/scene/poses.json"));
    let [mut cameras, mut truths, mut infos] = [Map::new(), Map::new(), Map::new()];
    for (index, camera) in rig["cameras"].as_array().unwrap().iter().enumerate() {
        fs::copy(root().join(IMAGES[index]), scene.join(format!("rgb/{index:06}.jpg"))).unwrap();
        let camera_from_rig = pose(&camera["rig_from_camera"]).inverse();
        let mut entry = bop(&camera_from_rig, "cam_R_w2c", "cam_t_w2c");
        entry["cam_K"] = json!([600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0]);
        cameras.insert(index.to_string(), entry);
        let truth = |object: &Value| {
            let mut truth = bop(&(camera_from_rig * pose(object)), "cam_R_m2c", "cam_t_m2c");
            truth["obj_id"] = object["obj_id"].clone();
            truth
        };
        let of_image: Vec<Value> = objects.as_array().unwrap().iter().map(truth).collect();
        // About the object's projection, as large as it is at its distance.
        let info = |truth: &Value| {
            let t: [f64; 3] = serde_json::from_value(truth["cam_t_m2c"].clone()).unwrap();
            let side = 600.0 * 80.0 / t[2];
            let (x, y) = (600.0 * t[0] / t[2] + 319.5 - side / 2.0, 600.0 * t[1] / t[2] + 239.5 - side / 2.0);
            json!({"bbox_visib": [x.round(), y.round(), side.round(), side.round()], "bbox_obj": [x.round(), y.round(), side.round(), side.round()], "visib_fract": 1.0})
        };
        infos.insert(index.to_string(), of_image.iter().map(info).collect());
        truths.insert(index.to_string(), Value::Array(of_image));
    }
    for (name, value) in [("scene_camera", cameras), ("scene_gt", truths), ("scene_gt_info", infos)] {
        fs::write(scene.join(format!("{name}.json")), Value::Object(value).to_string()).unwrap();
    }
    split
}

#[test]
fn evaluate_scores_fused_views() {
    let split = split();
    let json = split.path().join("views.json");
    let common =
        ["evaluate", "cube", "link", "--meshes", "training/demo/models", "--split", split.path().to_str().unwrap()];
    let output = run(&[&common[..], &["--views", "1", "--views", "3", "--json", json.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows: Vec<Value> = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    assert_eq!(rows.len(), 6);
    let row =
        |object: &str, views: u64| rows.iter().find(|row| row["object"] == object && row["views"] == views).unwrap();
    for object in ["cube", "link"] {
        let fused = row(object, 3);
        assert_eq!((fused["poses"].as_u64(), fused["add"].as_f64()), (Some(1), Some(1.0)), "{fused}");
        assert!(fused["median_add_mm"].as_f64().unwrap() < 5.0, "{fused}");
        assert_eq!(row(object, 1)["poses"], 10);
    }
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with("| object | views |"), "{text}");
    // Where cameras are known better, the same errors are more of their sigmas.
    let nees = |rows: &[Value], views: u64| {
        let row = rows.iter().find(|row| row["object"] == "cube" && row["views"] == views).unwrap();
        (row["nees_mean"].as_f64().unwrap(), row["poses"].as_u64())
    };
    let stated = nees(&rows, 3).0;
    let exact = ["--views", "1", "--views", "3", "--draws", "3", "--exact-cameras", "--json", json.to_str().unwrap()];
    assert!(run(&[&common[..], &exact].concat()).status.success());
    let rows: Vec<Value> = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    assert!(nees(&rows, 3).0 > 1.05 * stated, "{stated} {rows:?}");
    assert_eq!(nees(&rows, 1).1, Some(3));
    // One of the three is wrong, and found out.
    let output =
        run(&[&common[..], &["--views", "3", "--wrong-views", "1", "--json", json.to_str().unwrap()]].concat());
    assert!(output.status.success());
    let rows: Vec<Value> = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    assert!(rows.iter().all(|row| row["add"] == 1.0 && row["named"] == 1.0), "{rows:?}");
    let said = explanation(&run(&[&common[..], &["--views", "9"]].concat()));
    assert!(said.contains("no object is seen by so many views"), "{said}");
}

fn calibrate(split: &Path, images: &[&str], reference: &Path, extra: &[&str]) -> std::process::Output {
    let scene = split.join("000001");
    let mut arguments = vec!["calibrate", "cube", "--scene", scene.to_str().unwrap()];
    for image in images {
        arguments.extend(["--image", image]);
    }
    arguments.extend(["--reference", reference.to_str().unwrap()]);
    run(&[&arguments[..], extra].concat())
}

/// The link looks the same in four ways, of which each view shows any.
#[test]
fn the_scale_follows_the_stated_distances() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("references.json"), folder.path().join("reference"));
    let read = |path: &str| serde_json::from_slice::<Value>(&fs::read(root().join(path)).unwrap()).unwrap();
    let camera = read("samples/demo.camera.json");
    for name in ["link", "motor"] {
        let stated = |farther: f64| {
            let entry = |(image, seen): (&&str, &Pose)| {
                let [x, y, z] = seen.translation_m();
                let [u, v, half] = [600.0 * x / z + 319.5, 600.0 * y / z + 239.5, 600.0 * 0.05 / z];
                let seen = seen.scaled(farther);
                json!({
                    "image": root().join(image), "camera": camera, "box_px": [u - half, v - half, 2.0 * half, 2.0 * half],
                    "camera_from_object": {"rotation_xyzw": seen.rotation_xyzw(), "translation_m": seen.translation_m()},
                })
            };
            json!(IMAGES.iter().zip(&scene_poses(name)).map(entry).collect::<Vec<_>>())
        };
        for mode in ["weighted", "paper"] {
            let [as_is, farther] = [1.0, 1.03].map(|farther| {
                fs::write(&file, stated(farther).to_string()).unwrap();
                let (references, folder) = (file.to_str().unwrap(), out.to_str().unwrap());
                let words = ["calibrate", name, "--references", references, "--reference", folder, "--mode", mode];
                let output = run(&[&words[..], &["--fit-scale"]].concat());
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
                let stored = serde_json::from_slice::<Value>(&fs::read(out.join(format!("{name}.json"))).unwrap());
                stored.unwrap()["keypoints_scale"].as_f64().unwrap()
            });
            assert!((farther / as_is - 1.03).abs() < 3e-3, "{name} {mode}: {as_is} {farther}");
        }
    }
}

/// Every object of a scene's ground truth three hundredths farther away.
fn farther(images: &mut Value) {
    let objects = images.as_object_mut().unwrap().values_mut().flat_map(|image| image.as_array_mut().unwrap());
    for coordinate in objects.flat_map(|object| object["cam_t_m2c"].as_array_mut().unwrap()) {
        *coordinate = (1.03 * coordinate.as_f64().unwrap()).into();
    }
}

/// The scale is said, stored only on demand, and then in use: a larger object is farther away.
#[test]
fn calibrate_fits_the_scale_on_demand() {
    let (split, reference) = (split(), tempfile::tempdir().unwrap());
    let file = reference.path().join("cube.json");
    let stored = || serde_json::from_slice::<Value>(&fs::read(&file).unwrap()).unwrap()["keypoints_scale"].as_f64();
    let output = calibrate(split.path(), &["0", "1", "2"], reference.path(), &[]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && text.contains("scale of the keypoints: "), "{text}");
    assert_eq!(stored(), None);
    // Cameras that stand three hundredths farther off show what seems to be a larger object.
    let truth = split.path().join("000001/scene_gt.json");
    let written = fs::read(&truth).unwrap();
    crate::support::change(&truth, farther);
    let output = calibrate(split.path(), &["0", "1", "2"], reference.path(), &[]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("too short; add --fit-scale"), "{text}");
    fs::write(&truth, written).unwrap();
    let output = calibrate(split.path(), &["0", "1", "2"], reference.path(), &["--fit-scale"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && text.contains("stored"), "{text}");
    let scale = stored().unwrap();
    assert!((scale - 1.0).abs() < 0.05, "{scale}");
    let output = calibrate(split.path(), &["0", "1"], reference.path(), &[]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("as in the reference before"), "{text}");
    assert_eq!(stored(), Some(scale));
    let said = explanation(&calibrate(split.path(), &["0", "1"], reference.path(), &["--fit-scale"]));
    assert!(said.contains("at least three references"), "{said}");
    // Twice as large would be twice as far: what the file says is used, and shown.
    let depth = |scale: f64| {
        crate::support::change(&file, |json| json["keypoints_scale"] = scale.into());
        let folder = reference.path().to_str().unwrap();
        let output =
            run(&["estimate", IMAGES[0], "--camera", "samples/demo.camera.json", "--json", "--reference", folder]);
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        let pose = answer["poses"].as_array().unwrap().iter().find(|pose| pose["object"] == "cube").unwrap();
        (pose["camera_from_object"]["translation_m"][2].as_f64().unwrap(), pose["keypoints_scale"].as_f64())
    };
    let ((near, none), (far, shown)) = (depth(1.0), depth(1.2));
    assert!((far / near - 1.2).abs() < 0.05, "{near} {far}");
    assert_eq!((none, shown), (None, Some(1.2)));
    crate::support::change(&file, |json| json["keypoints_scale"] = 3.0.into());
    let folder = reference.path().to_str().unwrap();
    let said =
        explanation(&run(&["estimate", IMAGES[0], "--camera", "samples/demo.camera.json", "--reference", folder]));
    assert!(said.contains("'keypoints_scale' is 3; it must be between 0.8 and 1.25"), "{said}");
}
