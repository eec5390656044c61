//! Scenes without ground truth: images and the poses of their cameras.

use posed::evaluation::{DatasetError, ReadOptions, Scene, SceneFolder};
use serde_json::{Value, json};

use crate::folder::{Folder, camera, read_with};

fn options() -> ReadOptions {
    ReadOptions { without_truth: true, ..ReadOptions::default() }
}

/// Two images, no ground truth.
fn still_scene() -> Folder {
    let folder = Folder::new();
    let mut entry = camera();
    // The camera looks along the world's x.
    entry["cam_R_w2c"] = json!([0, -1, 0, 0, 0, -1, 1, 0, 0]);
    entry["cam_t_w2c"] = json!([0, 100, 500]);
    folder.put("scene_camera.json", &json!({"0": entry, "7": entry}).to_string());
    folder.put_image("rgb/000000.png");
    folder.put_image("rgb/000007.png");
    folder
}

fn read(folder: &Folder) -> Result<Scene, DatasetError> {
    read_with(folder.path(), &options())
}

#[test]
fn a_scene_without_truth_is_read_only_if_that_is_wanted() {
    let folder = still_scene();
    let scene = read(&folder).unwrap();
    assert_eq!(scene.image_ids().collect::<Vec<_>>(), [0, 7]);
    let view = scene.view(7).unwrap();
    assert!(view.objects.is_empty() && view.image.ends_with("rgb/000007.png"));
    let camera = *view.world_from_camera.unwrap().translation();
    assert!((camera - nalgebra::Vector3::new(-0.5, 0.0, 0.1)).norm() < 1e-12, "{camera}");
    assert!(folder.read().unwrap_err().to_string().contains("scene_gt.json"));
    // What is wrong with the ground truth is of no interest.
    folder.put("scene_gt.json", "nonsense");
    assert!(read(&folder).is_ok());
    let none = SceneFolder::at(Folder::new().path(), &options()).unwrap_err().to_string();
    assert!(none.contains("scene_camera.json") && !none.contains("scene_gt"), "{none}");
}

#[test]
fn camera_poses_are_read_beside_the_truth() {
    let folder = Folder::of_bop();
    assert!(folder.read().unwrap().view(0).unwrap().world_from_camera.unwrap_err().to_string().contains("'cam_R_w2c'"));
    folder.edit("scene_camera.json", |all| {
        all["0"]["cam_R_w2c"] = json!([1, 0, 0, 0, 1, 0, 0, 0, 1]);
        all["0"]["cam_t_w2c"] = json!([0, 0, 500]);
    });
    let view = folder.read().unwrap().view(0).unwrap();
    let camera = *view.world_from_camera.unwrap().translation();
    assert!((camera + nalgebra::Vector3::z() * 0.5).norm() < 1e-12, "{camera}");
    assert_eq!(view.objects.len(), 2);
}

#[test]
fn what_is_wrong_with_a_camera_pose_is_named() {
    type Case<'a> = (&'a dyn Fn(&mut Value), &'a str);
    let remove = |entry: &mut Value, fields: &[&str]| {
        entry.as_object_mut().unwrap().retain(|field, _| !fields.contains(&field.as_str()));
    };
    let cases: [Case<'_>; 7] = [
        (&|entry| remove(entry, &["cam_R_w2c", "cam_t_w2c"]), "fields 'cam_R_w2c' and 'cam_t_w2c' are missing"),
        (&|entry| remove(entry, &["cam_R_w2c"]), "'cam_R_w2c' is missing"),
        (&|entry| remove(entry, &["cam_t_w2c"]), "'cam_t_w2c' is missing"),
        (&|entry| entry["cam_t_w2c"] = json!([1, 2]), "'cam_t_w2c' has 2 numbers instead of 3"),
        (&|entry| entry["cam_R_w2c"] = json!([2, 0, 0, 0, 2, 0, 0, 0, 2]), "not a rotation"),
        // A reflection.
        (&|entry| entry["cam_R_w2c"] = json!([1, 0, 0, 0, 1, 0, 0, 0, -1]), "not a rotation"),
        (&|entry| entry["cam_t_w2c"] = json!("far"), "invalid type"),
    ];
    for (change, words) in cases {
        let folder = still_scene();
        folder.edit("scene_camera.json", |all| change(&mut all["0"]));
        let scene = read(&folder).unwrap();
        let error = scene.view(0).and_then(|view| view.world_from_camera).unwrap_err().to_string();
        for word in [words, "scene_camera.json: image 0: "] {
            assert!(error.contains(word), "{error}");
        }
        assert!(scene.view(7).unwrap().world_from_camera.is_ok());
    }
}

#[test]
fn camera_poses_in_metres_are_refused() {
    let folder = still_scene();
    folder.edit("scene_camera.json", |all| {
        for id in ["0", "7"] {
            all[id]["cam_t_w2c"] = json!([0.0, 0.1, 0.5]);
        }
    });
    let said = read(&folder).unwrap_err().to_string();
    assert!(said.contains("scene_camera.json: every 'cam_t_w2c'") && said.contains("metres"), "{said}");
}
