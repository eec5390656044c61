//! Scenes as LINEMOD was published before the BOP format: `gt.yml`, `info.yml`, and images with numbers of four digits.

use std::path::{Path, PathBuf};

use super::entry::{CameraEntry, PoseEntry, Seen, seen_by};
use super::error::{DatasetError, ImageError, ImageProblem};
use super::file::{ByNumber, yaml_by_number};
use super::scene::{Annotation, GroundTruth, Known, Scene, check_unit};
use posed_core::geometry::Camera;

pub(super) fn poses_file(scene: &Path) -> PathBuf {
    scene.join("gt.yml")
}

/// Reads a scene; `camera` is that of its images where no `info.yml` states one.
pub(super) fn read(scene: &Path, camera: Option<&Camera>) -> Result<Scene, DatasetError> {
    let path = poses_file(scene);
    let poses: ByNumber<Vec<PoseEntry>> = yaml_by_number(&path)?;
    check_unit(&path, "cam_t_m2c", poses.values().flatten().flatten().filter_map(PoseEntry::distance))?;
    let cameras = Cameras::read(scene, camera)?;
    let known = |(image_id, poses): (u32, Result<Vec<PoseEntry>, String>)| {
        let wrong = |problem| ImageError { path: path.clone(), image_id, problem };
        let annotations = |poses: Vec<PoseEntry>| {
            let truth = |(place, pose)| annotation(place, &pose, wrong);
            poses.into_iter().enumerate().map(truth).collect()
        };
        let objects = poses.map(annotations).map_err(|reason| wrong(ImageProblem::Syntax(reason)));
        let (camera, world_from_camera) = cameras.of(image_id);
        (image_id, Known { camera, world_from_camera, objects })
    };
    Scene::new(scene, "", poses.into_iter().map(known).collect())
}

fn annotation(place: usize, pose: &PoseEntry, wrong: impl Fn(ImageProblem) -> ImageError) -> Annotation {
    let truth = || {
        let camera_from_object = pose.pose(place)?;
        let bounding_box = pose.bounding_box("obj_bb", pose.obj_bb.as_deref(), place)?;
        Ok(GroundTruth { obj_id: pose.obj_id, place, camera_from_object, bounding_box, visible_fraction: None })
    };
    Annotation { obj_id: pose.obj_id, truth: truth().map_err(wrong) }
}

enum Cameras {
    Stated { path: PathBuf, entries: ByNumber<CameraEntry> },
    Given { path: PathBuf, camera: Camera },
}

impl Cameras {
    fn read(scene: &Path, given: Option<&Camera>) -> Result<Self, DatasetError> {
        let path = scene.join("info.yml");
        match given {
            _ if path.is_file() => Ok(Self::Stated { entries: yaml_by_number(&path)?, path }),
            Some(camera) => Ok(Self::Given { path: poses_file(scene), camera: camera.clone() }),
            None => Err(DatasetError::NoCamera { path: poses_file(scene) }),
        }
    }

    /// An image's camera and its pose in the world.
    fn of(&self, image_id: u32) -> Seen {
        match self {
            Self::Given { camera, path } => {
                let error = ImageError { path: path.clone(), image_id, problem: ImageProblem::NoCameraPose };
                (Ok(camera.clone()), Err(error))
            }
            Self::Stated { path, entries } => {
                let wrong = |problem| ImageError { path: path.clone(), image_id, problem };
                let absent = ImageProblem::NotListed { listed: "gt.yml".into() };
                let entry = entries.get(&image_id).ok_or(absent);
                seen_by(entry.and_then(|entry| entry.as_ref().map_err(|e| ImageProblem::Syntax(e.clone()))), wrong)
            }
        }
    }
}
