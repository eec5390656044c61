use std::fs;
use std::path::{Path, PathBuf};

use posed::evaluation::{DatasetError, ReadOptions, Scene, SceneFolder};
use serde_json::{Value, json};

/// A folder that a test fills.
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// A scene of the BOP format: two images, in each objects 1 and 2.
    pub(crate) fn of_bop() -> Self {
        let folder = Self::new();
        folder.put("scene_camera.json", &by_image(&camera()).to_string());
        folder.put("scene_gt.json", &by_image(&json!([pose(1, 500.0), pose(2, 600.0)])).to_string());
        folder.put("scene_gt_info.json", &by_image(&json!([info(0.9), info(0.5)])).to_string());
        folder.put_image("rgb/000000.png");
        folder.put_image("rgb/000007.png");
        folder
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn put(&self, name: &str, text: &str) -> PathBuf {
        self.put_bytes(name, text.as_bytes())
    }

    pub(crate) fn put_bytes(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    }

    pub(crate) fn put_image(&self, name: &str) {
        let path = self.put(name, "");
        image::GrayImage::new(32, 24).save(path).unwrap();
    }

    /// Changes what a JSON file states.
    pub(crate) fn edit(&self, name: &str, change: impl FnOnce(&mut Value)) {
        let mut value = serde_json::from_slice(&fs::read(self.path().join(name)).unwrap()).unwrap();
        change(&mut value);
        self.put(name, &value.to_string());
    }

    pub(crate) fn read(&self) -> Result<Scene, DatasetError> {
        read_with(self.path(), &ReadOptions::default())
    }
}

pub(crate) fn read_with(folder: &Path, options: &ReadOptions) -> Result<Scene, DatasetError> {
    SceneFolder::at(folder, options)?.read(options)
}

fn by_image(entry: &Value) -> Value {
    json!({"0": entry, "7": entry})
}

pub(crate) fn camera() -> Value {
    json!({"cam_K": [600.0, 0.0, 319.5, 0.0, 610.0, 239.5, 0.0, 0.0, 1.0], "depth_scale": 1.0})
}

pub(crate) fn pose(obj_id: u32, z_mm: f64) -> Value {
    let turned = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    json!({"obj_id": obj_id, "cam_R_m2c": turned, "cam_t_m2c": [10.0, -20.0, z_mm]})
}

pub(crate) fn info(visible: f64) -> Value {
    json!({"bbox_obj": [1, 2, 30, 40], "bbox_visib": [1, 2, 20, 40], "px_count_visib": 7, "visib_fract": visible})
}
