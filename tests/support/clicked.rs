//! Clicks in the bundled scene of three views.
#![allow(unreachable_pub, reason = "each test file uses a part of this")]

use nalgebra::Vector3;
use posed_core::geometry::{Camera, Pose};
use serde_json::{Value, json};

use crate::support::{read, root, scene_cameras};

/// Of the cube's frame.
const POINTS: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.03], [0.03, 0.03, 0.01]];

/// The cube in the scene's views.
pub struct ClickedCube {
    pub camera: Value,
    pub camera_from_cube: Vec<Pose>,
}

impl ClickedCube {
    pub fn new() -> Self {
        let json_of =
            |name: &str| -> Value { serde_json::from_slice(&read(&root().join("samples").join(name))).unwrap() };
        let known = json_of("scene/poses.json");
        let rig_from_cube = pose(known.as_array().unwrap().iter().find(|known| known["object"] == "cube").unwrap());
        let camera_from_cube = scene_cameras().iter().map(|camera| pose(camera).inverse() * rig_from_cube).collect();
        Self { camera: json_of("demo.camera.json"), camera_from_cube }
    }

    /// Exact clicks in two of the views.
    pub fn pair(&self, first: usize, second: usize) -> Value {
        let lens: Camera = serde_json::from_value(self.camera.clone()).unwrap();
        let pixel = |view: usize, point: &[f64; 3]| {
            let pixel = lens.project(&self.camera_from_cube[view].transform(&Vector3::from(*point))).unwrap();
            [pixel.x, pixel.y]
        };
        let clicks = POINTS.map(|point| json!({"first_px": pixel(first, &point), "second_px": pixel(second, &point)}));
        let second_from_first = self.camera_from_cube[second] * self.camera_from_cube[first].inverse();
        json!({
            "first_camera": self.camera, "second_camera": self.camera, "clicks": clicks,
            "second_from_first": {
                "rotation_xyzw": second_from_first.rotation_xyzw(), "translation_m": second_from_first.translation_m(),
            },
            "frame": {"origin": 0, "on_x": 1, "in_xy": 2},
        })
    }

    /// Checks a reference's views, of which the first is that of the scene's first.
    pub fn assert_right(&self, made: &Value) {
        for (view, made) in made.as_array().unwrap().iter().enumerate() {
            let (made, true_pose) = (pose(&made["camera_from_object"]), self.camera_from_cube[view]);
            let apart_m = (made.translation() - true_pose.translation()).norm();
            assert!(apart_m < 1e-4 && made.angle_to(&true_pose) < 1e-3, "{view}: {made:?}");
        }
    }
}

fn pose(json: &Value) -> Pose {
    let numbers = |field: &str| json[field].clone();
    let rotation = serde_json::from_value(numbers("rotation_xyzw")).unwrap();
    Pose::from_quaternion_xyzw(rotation, serde_json::from_value(numbers("translation_m")).unwrap()).unwrap()
}
