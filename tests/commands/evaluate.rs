//! `posed evaluate` on splits with faults.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::{Value, json};

use crate::SCENE;
use crate::support::{copy_of, explanation, run};

/// A split of one scene, number 5, with the same image several times.
fn split(images: usize) -> tempfile::TempDir {
    let split = tempfile::tempdir().unwrap();
    let scene = split.path().join("000005");
    fs::rename(copy_of(SCENE).keep(), &scene).unwrap();
    for name in ["scene_gt.json", "scene_gt_info.json", "scene_camera.json"] {
        edit(&scene.join(name), |all| {
            for id in 1..images {
                all[id.to_string()] = all["0"].clone();
            }
        });
    }
    for id in 1..images {
        fs::copy(scene.join("rgb/000000.jpg"), scene.join(format!("rgb/{id:06}.jpg"))).unwrap();
    }
    split
}

fn edit(path: &Path, change: impl FnOnce(&mut Value)) {
    let mut value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    change(&mut value);
    fs::write(path, value.to_string()).unwrap();
}

fn evaluate(split: &Path, extra: &[&str]) -> Output {
    let common = ["evaluate", "cube", "--split", split.to_str().unwrap(), "--meshes", "training/demo/models"];
    run(&[&common[..], extra].concat())
}

/// The cells of the table's only row.
fn row(output: &Output) -> Vec<String> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().last().unwrap().split('|').map(|cell| cell.trim().to_owned()).collect()
}

#[test]
fn several_jobs_score_as_one_does() {
    let split = split(5);
    let [one, three] = ["1", "3"].map(|jobs| row(&evaluate(split.path(), &["--jobs", jobs, "--threads", "1"])));
    assert_eq!((one[2].as_str(), &one), ("5", &three));
}

#[test]
fn what_cannot_be_scored_is_listed_or_left_out() {
    let split = split(4);
    let scene = split.path().join("000005");
    fs::remove_file(scene.join("rgb/000001.jpg")).unwrap();
    edit(&scene.join("scene_gt_info.json"), |all| drop(all["2"].as_array_mut().unwrap().pop()));
    // No fault of the cube's.
    edit(&scene.join("scene_gt.json"), |all| all["0"][1]["cam_R_m2c"] = json!([2, 0, 0, 0, 2, 0, 0, 0, 2]));
    let said = explanation(&evaluate(split.path(), &[]));
    for words in ["2 problems", "--keep-going", "image 1: ", "image 2: 3 objects, but 4"] {
        assert!(said.contains(words), "{said}");
    }
    let output = evaluate(split.path(), &["--keep-going"]);
    assert_eq!(row(&output)[2], "2");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("skipped because of 2 problems"), "{said}");
    // Pixels are found to be damaged only when they are read.
    fs::write(scene.join("rgb/000003.jpg"), "no image").unwrap();
    assert!(explanation(&evaluate(split.path(), &[])).contains("2 problems"));
    let output = evaluate(split.path(), &["--keep-going"]);
    assert_eq!(row(&output)[2], "1");
    assert!(String::from_utf8_lossy(&output.stderr).contains("rgb/000003.jpg"));
}

#[test]
fn damaged_pixels_are_an_error() {
    let split = split(1);
    fs::write(split.path().join("000005/rgb/000000.jpg"), "no image").unwrap();
    let said = explanation(&evaluate(split.path(), &[]));
    assert!(said.contains("rgb/000000.jpg") && said.contains("--keep-going"), "{said}");
    let said = explanation(&evaluate(split.path(), &["--keep-going"]));
    assert!(said.contains("rgb/000000.jpg") && said.contains("no view of cube"), "{said}");
}

#[test]
fn lists_of_different_length_are_an_error() {
    let split = split(1);
    edit(&split.path().join("000005/scene_gt_info.json"), |all| all["0"] = json!([]));
    let said = explanation(&evaluate(split.path(), &[]));
    assert!(said.contains("scene_gt_info.json: image 0: 0 objects, but 4 in scene_gt.json"), "{said}");
}

#[test]
fn an_object_that_is_not_seen_is_no_view_of_it() {
    let split = split(2);
    edit(&split.path().join("000005/scene_gt_info.json"), |all| all["1"][0]["bbox_visib"] = json!([-1, -1, -1, -1]));
    let output = evaluate(split.path(), &["--min-visible", "0"]);
    assert_eq!(row(&output)[2], "1");
    assert!(String::from_utf8_lossy(&output.stderr).contains("not visible: 1"));
}

#[test]
fn only_targets_are_scored() {
    let split = split(3);
    let targets = split.path().join("test_targets_bop19.json");
    let put = |list: Value| fs::write(&targets, list.to_string()).unwrap();
    let extra = ["--targets", targets.to_str().unwrap()];
    put(
        json!([{"scene_id": 5, "im_id": 2, "obj_id": 1, "inst_count": 1}, {"scene_id": 5, "im_id": 0, "obj_id": 2, "inst_count": 1}]),
    );
    assert_eq!(row(&evaluate(split.path(), &extra))[2], "1");
    put(
        json!([{"scene_id": 5, "im_id": 2, "obj_id": 1, "inst_count": 1}, {"scene_id": 5, "im_id": 77, "obj_id": 1, "inst_count": 1}]),
    );
    let said = explanation(&evaluate(split.path(), &extra));
    assert!(said.contains("scene 5") && said.contains("image 77"), "{said}");
}
