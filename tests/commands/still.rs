//! `posed evaluate --without-truth` on four images of a still scene.

use std::fs;
use std::path::Path;
use std::process::Output;

use posed_core::geometry::Pose;
use serde_json::Value;

use crate::support::{copy_of, explanation, read, run};

const STILL: &str = "tests/data/still";

fn evaluate(scene: &Path, extra: &[&str]) -> Output {
    let common = ["evaluate", "cube", "motor", "--split", scene.to_str().unwrap(), "--without-truth"];
    run(&[&common[..], extra].concat())
}

fn edit_cameras(scene: &Path, change: impl FnOnce(&mut Value)) {
    let path = scene.join("scene_camera.json");
    let mut value = serde_json::from_slice(&read(&path)).unwrap();
    change(&mut value);
    fs::write(path, value.to_string()).unwrap();
}

/// Figures of one object.
fn figures(report: &Path, object: &str) -> Value {
    let report: Value = serde_json::from_slice(&read(report)).unwrap();
    report["objects"].as_array().unwrap().iter().find(|one| one["object"] == object).unwrap().clone()
}

#[test]
fn the_views_of_a_still_scene_agree_unless_a_camera_pose_is_wrong() {
    let scene = copy_of(STILL);
    let json = scene.path().join("agreement.json");
    // What is judged is what the poses say of each other, not what their evidence says.
    let all = ["--json", json.to_str().unwrap(), "--ok-probability", "0"];
    let evaluate = |extra: &[&str]| {
        let output = evaluate(scene.path(), &[&all, extra].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let table = evaluate(&[]);
    for object in ["cube", "motor"] {
        assert!(table.lines().any(|line| line.starts_with(&format!("| {object} | 4 | 1 | "))), "{table}");
        let found = figures(&json, object);
        assert_eq!((&found["images"], &found["ok_disagreeing"]), (&4.into(), &0.into()), "{found}");
        let spread = &found["spread_of_ok"];
        let (median_m, p90_m) = (&spread["translation_m"]["median"], &spread["translation_m"]["p90"]);
        assert!(median_m.as_f64().unwrap() > 0.0 && p90_m.as_f64().unwrap() < 0.009, "{spread}");
        let ids = found["scenes"][0]["instances"][0]["observations"].as_array().unwrap();
        assert_eq!(ids.iter().map(|one| one["image_id"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 3, 5, 7]);
    }
    assert_eq!(table, evaluate(&["--jobs", "3", "--threads", "1"]));
    // The third camera stands 5 cm beside where it is said to stand: all its poses are wrong by that.
    edit_cameras(scene.path(), |all| {
        let x = all["5"]["cam_t_w2c"][0].as_f64().unwrap();
        all["5"]["cam_t_w2c"][0] = (x + 50.0).into();
    });
    let table = evaluate(&[]);
    assert!(table.contains("cube: ok but in disagreement: image 5\n"), "{table}");
    assert!(table.contains("motor: ok but in disagreement: image 5\n"), "{table}");
}

/// The poses in the world are those that the scene was rendered with.
#[test]
fn poses_are_those_of_the_world() {
    let scene = copy_of(STILL);
    let json = scene.path().join("agreement.json");
    assert!(evaluate(scene.path(), &["--json", json.to_str().unwrap()]).status.success());
    let pose = |name: &str| {
        let found = figures(&json, name)["scenes"][0]["instances"][0]["world_from_object"].clone();
        let part = |field: &str| found[field].clone();
        let rotation = serde_json::from_value(part("rotation_xyzw")).unwrap();
        Pose::from_quaternion_xyzw(rotation, serde_json::from_value(part("translation_m")).unwrap()).unwrap()
    };
    for (name, rotation, translation_m) in TRUTH {
        let truth = Pose::from_row_major(rotation, translation_m).unwrap();
        let found = pose(name);
        assert!((found.translation() - truth.translation()).norm() < 0.006, "{name}: {found:?}");
        assert!(found.angle_to(&truth).to_degrees() < 4.0, "{name}: {found:?}");
    }
}

#[test]
fn what_is_missing_is_said() {
    let scene = copy_of(STILL);
    edit_cameras(scene.path(), |all| drop(all["3"].as_object_mut().unwrap().remove("cam_R_w2c")));
    let said = explanation(&evaluate(scene.path(), &[]));
    assert!(said.contains("scene_camera.json: image 3: field 'cam_R_w2c' is missing"), "{said}");
    let output = evaluate(scene.path(), &["--keep-going"]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("| cube | 3 | 1 | "), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("skipped because of 1 problems"));
    fs::write(scene.path().join("rgb/000005.jpg"), "no image").unwrap();
    let output = evaluate(scene.path(), &["--keep-going"]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("| cube | 2 | 1 | "), "{output:?}");
    let said = explanation(&evaluate(scene.path(), &["--keep-going", "--json", "no/such/folder.json"]));
    assert!(said.contains("no/such"), "{said}");
}

#[test]
fn options_of_the_truth_are_refused_without_it() {
    for (extra, words) in [
        (&["--meshes", "models"][..], "--meshes"),
        (&["--targets", "targets.json"], "--targets"),
        (&["--visible", "0.5..1"], "--visible"),
        (&["--detector"], "--detector"),
        (&["--camera", "samples/demo.camera.json"], "--camera"),
    ] {
        let said = explanation(&evaluate(Path::new(STILL), extra));
        assert!(said.contains("cannot be used with") && said.contains(words), "{said}");
    }
    let said = explanation(&run(&["evaluate", "cube", "--split", STILL]));
    assert!(said.contains("--meshes"), "{said}");
    let said = explanation(&run(&["evaluate", "teapot", "--split", STILL, "--without-truth"]));
    assert!(said.contains("\"teapot\"") && said.contains("cube"), "{said}");
}

/// Object, rotation (row-major) and translation of `world_from_object`.
const TRUTH: [(&str, [f64; 9], [f64; 3]); 2] = [
    ("cube", [0.0, -0.2140, 0.9768, 0.0, 0.9768, 0.2140, -1.0, -0.0, -0.0], [-0.0140, -0.008, 0.0277]),
    ("motor", [0.1995, -0.2746, 0.9406, 0.0570, 0.9616, 0.2686, -0.9782, -0.0, 0.2075], [0.1045, -0.0182, 0.0238]),
];
