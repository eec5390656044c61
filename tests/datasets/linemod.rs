use posed::evaluation::{ReadOptions, scenes};
use posed_core::geometry::Camera;

use crate::folder::{Folder, read_with};

const POSES: &str = "\
0:
- cam_R_m2c: [1.00000000, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
  cam_t_m2c: [103.57929656, 49.49001985, 1040.43577706]
  obj_bb: [344, 228, 77, 84]
  obj_id: 4
12:
- cam_R_m2c: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
  cam_t_m2c: [145.43133945, -4.09773472, 991.78603930]
  obj_bb: [367, 195, 82, 89]
  obj_id: 4
- cam_R_m2c: [0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
  cam_t_m2c: [1.0, 2.0, 990.0]
  obj_bb: [0, 0, -1, -1]
  obj_id: 6
";

const CAMERAS: &str = "\
0:
  cam_K: [572.4114, 0.0, 325.2611, 0.0, 573.57043, 242.04899, 0.0, 0.0, 1.0]
  depth_scale: 1.0
12:
  cam_K: [572.4114, 0.1, 325.2611, 0.0, 573.57043, 242.04899, 0.0, 0.0, 1.0]
  depth_scale: 1.0
";

fn data() -> Folder {
    let folder = Folder::new();
    folder.put("04/gt.yml", POSES);
    folder.put_image("04/rgb/0000.png");
    folder.put_image("04/rgb/0012.png");
    folder
}

#[test]
fn the_camera_is_that_of_the_scene_or_the_one_given() {
    let data = data();
    let found = scenes(data.path(), &ReadOptions::default()).unwrap();
    let said = found[0].read(&ReadOptions::default()).unwrap_err().to_string();
    assert!(said.contains("gt.yml") && said.contains("no camera"), "{said}");
    let given = Camera::pinhole(500.0, 500.0, 320.0, 240.0).unwrap();
    let options = ReadOptions { camera: Some(given.clone()), ..ReadOptions::default() };
    let scene = found[0].read(&options).unwrap();
    assert_eq!((scene.id, scene.view(12).unwrap().camera), (Some(4), given));

    data.put("04/info.yml", CAMERAS);
    let scene = found[0].read(&options).unwrap();
    assert_eq!(scene.view(0).unwrap().camera, Camera::pinhole(572.4114, 573.57043, 325.2611, 242.04899).unwrap());
    let said = scene.view(12).unwrap_err().to_string();
    assert!(said.contains("info.yml: image 12") && said.contains("skew"), "{said}");
}

#[test]
fn poses_and_boxes_are_read() {
    let data = data();
    let camera = Camera::pinhole(500.0, 500.0, 320.0, 240.0).unwrap();
    let options = ReadOptions { camera: Some(camera), ..ReadOptions::default() };
    let scene = read_with(&data.path().join("04"), &options).unwrap();
    let view = scene.view(0).unwrap();
    assert!(view.image.ends_with("04/rgb/0000.png"));
    let truth = view.truths(4).unwrap()[0].clone();
    assert_eq!((truth.bounding_box.unwrap().width, truth.visible_fraction), (77.0, None));
    assert!((truth.camera_from_object.translation().z - 1.040_435_777_06).abs() < 1e-12);
    let view = scene.view(12).unwrap();
    assert_eq!(view.truths(4).unwrap().len(), 1);
    let said = view.truths(6).unwrap_err().to_string();
    assert!(said.contains("gt.yml: image 12: object 6") && said.contains("not a rotation"), "{said}");
}

#[test]
fn a_damaged_file_is_named_with_its_line() {
    let data = data();
    data.put("04/gt.yml", &POSES[..POSES.len() / 2]);
    let camera = Camera::pinhole(500.0, 500.0, 320.0, 240.0).unwrap();
    let options = ReadOptions { camera: Some(camera), ..ReadOptions::default() };
    let said = read_with(&data.path().join("04"), &options).unwrap_err().to_string();
    assert!(said.contains("gt.yml") && said.contains("line"), "{said}");
    data.put("04/gt.yml", "");
    let said = read_with(&data.path().join("04"), &options).unwrap_err().to_string();
    assert!(said.contains("04"), "{said}");
}
