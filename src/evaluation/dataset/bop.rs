//! Scenes of the BOP format: <https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md>.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::entry::{CameraEntry, InfoEntry, PoseEntry, seen_by};
use super::error::{DatasetError, ImageError, ImageProblem};
use super::file::{ByNumber, json_by_number};
use super::scene::{Annotation, GroundTruth, Known, Scene, check_unit};

/// `scene_gt.json`, or that of a sensor.
pub(super) fn poses_file(scene: &Path, sensor: &str) -> PathBuf {
    scene.join(named("scene_gt", sensor))
}

fn named(stem: &str, sensor: &str) -> String {
    if sensor.is_empty() { format!("{stem}.json") } else { format!("{stem}_{sensor}.json") }
}

/// A file beside the poses: that of the sensor, or the one for all sensors.
fn beside(scene: &Path, stem: &str, sensor: &str) -> PathBuf {
    let own = scene.join(named(stem, sensor));
    if own.is_file() { own } else { scene.join(named(stem, "")) }
}

/// `scene_camera.json`, or that of a sensor.
pub(super) fn cameras_file(scene: &Path, sensor: &str) -> PathBuf {
    beside(scene, "scene_camera", sensor)
}

/// The images and cameras of a scene, without its ground truth.
pub(super) fn read_cameras(scene: &Path, sensor: &str) -> Result<Scene, DatasetError> {
    let path = cameras_file(scene, sensor);
    let entries: ByNumber<CameraEntry> = json_by_number(&path)?;
    check_unit(&path, "cam_t_w2c", entries.values().flatten().filter_map(CameraEntry::world_distance))?;
    let known = |(image_id, entry): (u32, Result<CameraEntry, String>)| {
        let wrong = |problem| ImageError { path: path.clone(), image_id, problem };
        let (camera, world_from_camera) =
            seen_by(entry.as_ref().map_err(|reason| ImageProblem::Syntax(reason.clone())), wrong);
        (image_id, Known { camera, world_from_camera, objects: Ok(Vec::new()) })
    };
    Scene::new(scene, sensor, entries.into_iter().map(known).collect())
}

pub(super) fn read(scene: &Path, sensor: &str) -> Result<Scene, DatasetError> {
    let path = poses_file(scene, sensor);
    let poses: ByNumber<Vec<PoseEntry>> = json_by_number(&path)?;
    check_unit(&path, "cam_t_m2c", poses.values().flatten().flatten().filter_map(PoseEntry::distance))?;
    let mut reader = Reader {
        poses_name: named("scene_gt", sensor),
        cameras: json_by_number(&cameras_file(scene, sensor))?,
        cameras_path: cameras_file(scene, sensor),
        infos: json_by_number(&beside(scene, "scene_gt_info", sensor))?,
        infos_path: beside(scene, "scene_gt_info", sensor),
        path,
    };
    let images: BTreeMap<_, _> = poses.into_iter().map(|(id, poses)| (id, reader.known(id, poses))).collect();
    Scene::new(scene, sensor, images)
}

struct Reader {
    path: PathBuf,
    poses_name: String,
    cameras_path: PathBuf,
    cameras: ByNumber<CameraEntry>,
    infos_path: PathBuf,
    infos: ByNumber<Vec<InfoEntry>>,
}

impl Reader {
    fn known(&mut self, image_id: u32, poses: Result<Vec<PoseEntry>, String>) -> Known {
        let wrong = |problem| ImageError { path: self.cameras_path.clone(), image_id, problem };
        let entry = taken(&mut self.cameras, image_id, &self.poses_name);
        let (camera, world_from_camera) = seen_by(entry.as_ref().map_err(Clone::clone), wrong);
        Known { camera, world_from_camera, objects: self.objects(image_id, poses) }
    }

    fn objects(&mut self, image_id: u32, poses: Result<Vec<PoseEntry>, String>) -> Result<Vec<Annotation>, ImageError> {
        let in_poses = |problem| ImageError { path: self.path.clone(), image_id, problem };
        let in_infos = |problem| ImageError { path: self.infos_path.clone(), image_id, problem };
        let poses = poses.map_err(|reason| in_poses(ImageProblem::Syntax(reason)))?;
        let infos = taken(&mut self.infos, image_id, &self.poses_name).map_err(in_infos)?;
        if poses.len() != infos.len() {
            let listed = self.poses_name.clone();
            return Err(in_infos(ImageProblem::Lengths { infos: infos.len(), poses: poses.len(), listed }));
        }
        let annotation = |(place, (pose, info)): (usize, (PoseEntry, InfoEntry))| {
            let truth = || {
                let camera_from_object = pose.pose(place).map_err(in_poses)?;
                let stated = info.bbox_visib.as_deref();
                let bounding_box = pose.bounding_box("bbox_visib", stated, place).map_err(in_infos)?;
                let visible_fraction = pose.visible_fraction(info.visib_fract, place).map_err(in_infos)?;
                Ok(GroundTruth { obj_id: pose.obj_id, place, camera_from_object, bounding_box, visible_fraction })
            };
            Annotation { obj_id: pose.obj_id, truth: truth() }
        };
        Ok(poses.into_iter().zip(infos).enumerate().map(annotation).collect())
    }
}

fn taken<T>(entries: &mut ByNumber<T>, image_id: u32, listed: &str) -> Result<T, ImageProblem> {
    let entry = entries.remove(&image_id).ok_or_else(|| ImageProblem::NotListed { listed: listed.into() })?;
    entry.map_err(ImageProblem::Syntax)
}
