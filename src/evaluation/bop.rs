//! Reads scenes of the BOP format: <https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md>.
//! Millimetres become metres here and nowhere else.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use crate::model::{ManifestError, read_json};
use crate::vision::BoundingBox;
use posed_core::geometry::{Camera, CameraError, METRES_PER_MILLIMETRE, Pose, PoseError};

/// A scene folder that cannot be read.
#[derive(Debug, Error)]
pub enum BopError {
    #[error(transparent)]
    File(#[from] ManifestError),
    #[error("cannot read {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error("{}: no image {image_id}", path.display())]
    NoImage { path: PathBuf, image_id: u32 },
    #[error("{}: image {image_id} is listed, but rgb/{image_id:06}.jpg or .png does not exist", path.display())]
    NoPixels { path: PathBuf, image_id: u32 },
    #[error("{}: image {image_id}: {source}", path.display())]
    Camera { path: PathBuf, image_id: u32, source: CameraError },
    #[error("{}: image {image_id}: {source}", path.display())]
    Pose { path: PathBuf, image_id: u32, source: PoseError },
}

/// One object in one image.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    pub obj_id: u32,
    pub camera_from_object: Pose,
    /// Box of the visible part.
    pub bounding_box: BoundingBox,
    pub visible_fraction: f64,
}

#[derive(Deserialize)]
struct CameraEntry {
    #[serde(rename = "cam_K")]
    cam_k: [f64; 9],
}

#[derive(Deserialize)]
struct PoseEntry {
    obj_id: u32,
    #[serde(rename = "cam_R_m2c")]
    rotation: [f64; 9],
    #[serde(rename = "cam_t_m2c")]
    translation_mm: [f64; 3],
}

#[derive(Deserialize)]
struct InfoEntry {
    bbox_visib: [f64; 4],
    visib_fract: f64,
}

/// The scene folders of a split, in order.
///
/// # Errors
/// When the folder cannot be read.
pub fn scenes(split: &Path) -> Result<Vec<PathBuf>, BopError> {
    let unreadable = |source| BopError::Folder { path: split.into(), source };
    let mut scenes = Vec::new();
    for entry in std::fs::read_dir(split).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.join("scene_gt.json").is_file() {
            scenes.push(path);
        }
    }
    scenes.sort();
    Ok(scenes)
}

/// Numbers of the images of a scene that have ground truth, in order.
///
/// # Errors
/// When `scene_gt.json` cannot be read.
#[expect(clippy::zero_sized_map_values, reason = "skips the values of a JSON object")]
pub fn image_ids(scene: &Path) -> Result<Vec<u32>, BopError> {
    let images: BTreeMap<u32, serde::de::IgnoredAny> = read_json(&scene.join("scene_gt.json"))?;
    Ok(images.into_keys().collect())
}

/// Reads one image's path, camera and objects from a scene folder.
///
/// # Errors
/// [`BopError`] names the file and the image.
pub fn read_image(scene: &Path, image_id: u32) -> Result<(PathBuf, Camera, Vec<GroundTruth>), BopError> {
    let camera: CameraEntry = entry(scene, "scene_camera.json", image_id)?;
    let [fx, _, cx, _, fy, cy, ..] = camera.cam_k;
    let camera = Camera::pinhole(fx, fy, cx, cy).map_err(|source| BopError::Camera {
        path: scene.join("scene_camera.json"),
        image_id,
        source,
    })?;
    let poses: Vec<PoseEntry> = entry(scene, "scene_gt.json", image_id)?;
    let infos: Vec<InfoEntry> = entry(scene, "scene_gt_info.json", image_id)?;
    let objects = poses
        .into_iter()
        .zip(infos)
        .map(|(pose, info)| {
            let [x, y, width, height] = info.bbox_visib;
            let translation_m = pose.translation_mm.map(|millimetres| millimetres * METRES_PER_MILLIMETRE);
            let camera_from_object = Pose::from_row_major(pose.rotation, translation_m)
                .map_err(|source| BopError::Pose { path: scene.join("scene_gt.json"), image_id, source })?;
            Ok(GroundTruth {
                obj_id: pose.obj_id,
                camera_from_object,
                bounding_box: BoundingBox { x, y, width, height },
                visible_fraction: info.visib_fract,
            })
        })
        .collect::<Result<_, BopError>>()?;
    let image = ["jpg", "png"]
        .map(|suffix| scene.join(format!("rgb/{image_id:06}.{suffix}")))
        .into_iter()
        .find(|path| path.exists())
        .ok_or_else(|| BopError::NoPixels { path: scene.into(), image_id })?;
    Ok((image, camera, objects))
}

fn entry<T: serde::de::DeserializeOwned>(scene: &Path, file: &str, image_id: u32) -> Result<T, BopError> {
    let path = scene.join(file);
    let mut images: BTreeMap<u32, T> = read_json(&path)?;
    images.remove(&image_id).ok_or(BopError::NoImage { path, image_id })
}
