use posed::evaluation::{ImageProblem, ReadOptions, scenes};
use posed::vision::BoundingBox;
use posed_core::geometry::Camera;
use serde_json::{Value, json};

use crate::folder::{Folder, camera, info, pose, read_with};

#[test]
fn a_scene_is_read_in_metres() {
    let folder = Folder::of_bop();
    let scene = folder.read().unwrap();
    assert_eq!(scene.image_ids().collect::<Vec<_>>(), [0, 7]);
    assert!(scene.may_show(7, 2) && !scene.may_show(7, 3) && !scene.may_show(8, 2));
    let view = scene.view(7).unwrap();
    assert_eq!(view.image, folder.path().join("rgb/000007.png"));
    assert_eq!(view.camera, Camera::pinhole(600.0, 610.0, 319.5, 239.5).unwrap());
    let truths = view.truths(2).unwrap();
    let [truth] = truths[..] else { panic!("{truths:?}") };
    assert_eq!((truth.place, truth.visible_fraction), (1, Some(0.5)));
    assert_eq!(truth.bounding_box, Some(BoundingBox { x: 1.0, y: 2.0, width: 20.0, height: 40.0 }));
    let origin = truth.camera_from_object.translation() - nalgebra::Vector3::new(0.01, -0.02, 0.6);
    assert!(origin.norm() < 1e-12);
    let on_x = truth.camera_from_object.rotation() * nalgebra::Vector3::x();
    assert!((on_x - nalgebra::Vector3::y()).norm() < 1e-12);
}

#[test]
fn images_may_be_grey_jpg_or_tif() {
    for name in ["gray/000000.tif", "gray/000000.png", "rgb/000000.jpg", "rgb/000000.tif", "rgb/0000.png"] {
        let folder = Folder::of_bop();
        std::fs::remove_dir_all(folder.path().join("rgb")).unwrap();
        folder.put_image(name);
        let image = folder.read().unwrap().view(0).unwrap().image;
        assert_eq!(image, folder.path().join(name));
        let options = posed::vision::DecodeOptions::default();
        assert_eq!(posed::vision::read_image(&image, &options).unwrap().dimensions(), (32, 24));
    }
}

#[test]
fn a_sensor_may_have_files_of_its_own() {
    let folder = Folder::of_bop();
    std::fs::rename(folder.path().join("scene_gt.json"), folder.path().join("scene_gt_primesense.json")).unwrap();
    assert!(folder.read().unwrap_err().to_string().contains("scene_gt.json"));
    let options = ReadOptions { sensor: "primesense".into(), ..ReadOptions::default() };
    assert!(read_with(folder.path(), &options).unwrap().view(0).unwrap().image.ends_with("rgb/000000.png"));
    folder.put_image("gray_primesense/000000.tif");
    let other = json!({"0": {"cam_K": [500.0, 0.0, 1.0, 0.0, 500.0, 2.0, 0.0, 0.0, 1.0]}});
    folder.put("scene_camera_primesense.json", &other.to_string());
    let scene = read_with(folder.path(), &options).unwrap();
    let view = scene.view(0).unwrap();
    assert!(view.image.ends_with("gray_primesense/000000.tif"));
    assert_eq!(view.camera, Camera::pinhole(500.0, 500.0, 1.0, 2.0).unwrap());
    let said = scene.view(7).unwrap_err().to_string();
    assert!(said.contains("scene_camera_primesense.json") && said.contains("image 7"), "{said}");
}

#[test]
fn a_split_is_its_scenes_in_order() {
    let split = Folder::new();
    for name in ["000012", "000003", "notes"] {
        split.put(&format!("{name}/readme.txt"), "");
    }
    for name in ["000012", "000003"] {
        split.put(&format!("{name}/scene_gt.json"), "{}");
    }
    let found = scenes(split.path(), &ReadOptions::default()).unwrap();
    let names: Vec<_> = found.iter().map(|scene| scene.path().file_name().unwrap().to_str().unwrap()).collect();
    assert_eq!(names, ["000003", "000012"]);
    let one = scenes(&split.path().join("000012"), &ReadOptions::default()).unwrap();
    assert_eq!(one.len(), 1);
    let none = scenes(&split.path().join("notes"), &ReadOptions::default()).unwrap_err().to_string();
    assert!(none.contains("notes: no scene"), "{none}");
    // Both are empty.
    let said = found[0].read(&ReadOptions::default()).unwrap_err().to_string();
    assert!(said.contains("scene_camera.json"), "{said}");
    split.put("000003/scene_camera.json", "{}");
    split.put("000003/scene_gt_info.json", "{}");
    let said = found[0].read(&ReadOptions::default()).unwrap_err().to_string();
    assert!(said.contains("000003: no images"), "{said}");
}

/// One image is wrong; the other is read all the same.
#[test]
fn what_is_wrong_with_an_image_is_named() {
    type Case<'a> = (&'a str, &'a dyn Fn(&mut Value), &'a [&'a str]);
    let cases: &[Case<'_>] = &[
        (
            "scene_gt_info.json",
            &|all| all["0"] = json!([info(0.9)]),
            &["scene_gt_info.json", "1 objects", "2 in scene_gt.json"],
        ),
        ("scene_gt.json", &|all| all["0"] = json!([]), &["scene_gt_info.json", "2 objects", "0 in scene_gt.json"]),
        ("scene_gt.json", &|all| all["0"][1]["obj_id"] = json!("two"), &["scene_gt.json", "invalid type"]),
        (
            "scene_camera.json",
            &|all| all["0"]["cam_K"][1] = json!(0.3),
            &["scene_camera.json", "'cam_K'", "skew", "K[0][1] is 0.3"],
        ),
        ("scene_camera.json", &|all| all["0"]["cam_K"] = json!([1, 2]), &["'cam_K' has 2 numbers instead of 9"]),
        ("scene_camera.json", &|all| all["0"] = json!({}), &["'cam_K' is missing"]),
        ("scene_camera.json", &|all| all["0"]["cam_K"][0] = json!(-600), &["'cam_K'", "'fx'"]),
        ("scene_camera.json", &|all| *all = json!({"7": camera()}), &["scene_camera.json", "not in this file"]),
        (
            "scene_gt_info.json",
            &|all| *all = json!({"7": [info(0.9), info(0.5)]}),
            &["scene_gt_info.json", "not in this file"],
        ),
    ];
    for (file, change, words) in cases {
        let folder = Folder::of_bop();
        folder.edit(file, change);
        let scene = folder.read().unwrap();
        let said = scene.view(0).unwrap_err().to_string();
        for word in words.iter().chain(&["image 0"]) {
            assert!(said.contains(word), "{said}: {word}");
        }
        assert_eq!(scene.view(7).unwrap().objects.len(), 2);
        assert!(scene.view(3).unwrap_err().to_string().contains("no image 3"));
    }
}

/// A fault of one object is no fault of the others in the image.
#[test]
fn what_is_wrong_with_an_object_is_its_own() {
    type Case<'a> = (&'a str, &'a dyn Fn(&mut Value), &'a str);
    let cases: &[Case<'_>] = &[
        ("scene_gt.json", &|object| object["cam_R_m2c"] = json!([2, 0, 0, 0, 2, 0, 0, 0, 2]), "'cam_R_m2c'"),
        ("scene_gt.json", &|object| object["cam_R_m2c"] = json!([1, 0, 0]), "'cam_R_m2c' has 3 numbers instead of 9"),
        ("scene_gt.json", &|object| object["cam_t_m2c"] = Value::Null, "'cam_t_m2c' is missing"),
        (
            "scene_gt_info.json",
            &|object| object["bbox_visib"] = json!([1, 2, 3]),
            "'bbox_visib' has 3 numbers instead of 4",
        ),
    ];
    for (file, change, words) in cases {
        let folder = Folder::of_bop();
        folder.edit(file, |all| change(&mut all["0"][1]));
        let view = folder.read().unwrap().view(0).unwrap();
        assert_eq!(view.truths(1).unwrap().len(), 1);
        let said = view.truths(2).unwrap_err().to_string();
        assert!(said.contains(words) && said.contains("image 0: object 2 (number 1"), "{said}");
        assert!(said.contains(file), "{said}");
    }
}

#[test]
fn an_invisible_object_is_no_fault() {
    let folder = Folder::of_bop();
    folder.edit("scene_gt_info.json", |all| {
        all["0"][0] = json!({"bbox_visib": [-1, -1, -1, -1], "visib_fract": 0.0});
    });
    let view = folder.read().unwrap().view(0).unwrap();
    assert_eq!(view.truths(1).unwrap()[0].bounding_box, None);
    assert!(view.truths(2).unwrap()[0].bounding_box.is_some());
}

#[test]
fn a_missing_image_is_named() {
    let folder = Folder::of_bop();
    std::fs::remove_file(folder.path().join("rgb/000000.png")).unwrap();
    let scene = folder.read().unwrap();
    let error = scene.view(0).unwrap_err();
    assert!(matches!(error.problem, ImageProblem::NoPixels { .. }));
    let said = error.to_string();
    assert!(said.contains("image 0") && said.contains("rgb/") && said.contains("000000"), "{said}");
    assert!(scene.view(7).is_ok());
}

#[test]
fn a_damaged_file_is_named() {
    for file in ["scene_gt.json", "scene_gt_info.json", "scene_camera.json"] {
        let folder = Folder::of_bop();
        let text = std::fs::read_to_string(folder.path().join(file)).unwrap();
        folder.put(file, &text[..text.len() / 2]);
        let said = folder.read().unwrap_err().to_string();
        assert!(said.contains(file) && said.contains("EOF"), "{said}");
    }
    let folder = Folder::of_bop();
    std::fs::remove_file(folder.path().join("scene_gt_info.json")).unwrap();
    assert!(folder.read().unwrap_err().to_string().contains("scene_gt_info.json"));
}

#[test]
fn metres_are_told_from_millimetres() {
    let folder = Folder::of_bop();
    folder.put("scene_gt.json", &json!({"0": [pose(1, 0.5)], "7": [pose(1, 0.9)]}).to_string());
    folder.edit("scene_gt.json", |all| all["0"][0]["cam_t_m2c"] = json!([0.01, 0.02, 0.5]));
    folder.edit("scene_gt.json", |all| all["7"][0]["cam_t_m2c"] = json!([0.01, 0.02, 0.9]));
    let said = folder.read().unwrap_err().to_string();
    assert!(said.contains("scene_gt.json") && said.contains("'cam_t_m2c'") && said.contains("metres"), "{said}");
}
