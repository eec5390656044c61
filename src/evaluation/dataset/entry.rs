//! One image's camera and objects as files state them. What a file leaves out or misspells is found out where it is asked for,
//! so that one object's fault is not that of the others.

use serde::Deserialize;

use super::error::{ImageError, ImageProblem};
use crate::vision::BoundingBox;
use posed_core::geometry::{Camera, METRES_PER_MILLIMETRE, Pose};

/// An entry of `scene_camera.json` or `info.yml`.
#[derive(Deserialize)]
pub(super) struct CameraEntry {
    #[serde(rename = "cam_K")]
    matrix: Option<Vec<f64>>,
    #[serde(rename = "cam_R_w2c")]
    world_rotation: Option<Vec<f64>>,
    #[serde(rename = "cam_t_w2c")]
    world_translation_mm: Option<Vec<f64>>,
}

/// An entry of `scene_gt.json` or `gt.yml`.
#[derive(Deserialize)]
pub(super) struct PoseEntry {
    pub(super) obj_id: u32,
    #[serde(rename = "cam_R_m2c")]
    rotation: Option<Vec<f64>>,
    #[serde(rename = "cam_t_m2c")]
    translation_mm: Option<Vec<f64>>,
    /// Box of the whole object, in LINEMOD.
    pub(super) obj_bb: Option<Vec<f64>>,
}

/// An entry of `scene_gt_info.json`.
#[derive(Deserialize)]
pub(super) struct InfoEntry {
    pub(super) bbox_visib: Option<Vec<f64>>,
    pub(super) visib_fract: Option<f64>,
}

impl CameraEntry {
    pub(super) fn camera(&self) -> Result<Camera, ImageProblem> {
        let matrix = self.matrix.as_deref().ok_or_else(|| ImageProblem::Matrix("is missing".into()))?;
        let &[fx, skew, cx, shear, fy, cy, left, below, one] = matrix else {
            return Err(ImageProblem::Matrix(format!("has {} numbers instead of 9", matrix.len())));
        };
        if skew != 0.0 {
            return Err(ImageProblem::Matrix(format!(
                "has a skew: K[0][1] is {skew}, and only 0 is supported; undo it in the image"
            )));
        }
        if [shear, left, below, one - 1.0].iter().any(|value| *value != 0.0) {
            return Err(ImageProblem::Matrix("must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]".into()));
        }
        Camera::pinhole(fx, fy, cx, cy).map_err(ImageProblem::Camera)
    }

    /// Distance of the world's origin in the file's unit, if it can be read.
    pub(super) fn world_distance(&self) -> Option<f64> {
        length(self.world_translation_mm.as_deref())
    }

    /// The camera's pose in the world.
    pub(super) fn world_from_camera(&self) -> Result<Pose, ImageProblem> {
        let (rotation, translation_mm) = (self.world_rotation.as_deref(), self.world_translation_mm.as_deref());
        if rotation.is_none() && translation_mm.is_none() {
            return Err(ImageProblem::NoCameraPose);
        }
        let rotation = world_numbers("cam_R_w2c", rotation)?;
        let translation_mm: [f64; 3] = world_numbers("cam_t_w2c", translation_mm)?;
        let translation_m = translation_mm.map(|millimetres| millimetres * METRES_PER_MILLIMETRE);
        let camera_from_world = Pose::from_row_major(rotation, translation_m).map_err(ImageProblem::CameraPose)?;
        Ok(camera_from_world.inverse())
    }
}

fn world_numbers<const N: usize>(field: &'static str, values: Option<&[f64]>) -> Result<[f64; N], ImageProblem> {
    let wrong = |reason: String| ImageProblem::CameraPoseField { field, reason };
    let values = values.ok_or_else(|| wrong("is missing".into()))?;
    values.try_into().map_err(|_| wrong(format!("has {} numbers instead of {N}", values.len())))
}

/// An image's camera, and its pose in the world.
pub(super) type Seen = (Result<Camera, ImageError>, Result<Pose, ImageError>);

/// What an entry says of both; why not, where it is not there or cannot be read.
pub(super) fn seen_by(entry: Result<&CameraEntry, ImageProblem>, wrong: impl Fn(ImageProblem) -> ImageError) -> Seen {
    match entry {
        Ok(entry) => (entry.camera().map_err(&wrong), entry.world_from_camera().map_err(&wrong)),
        Err(problem) => (Err(wrong(problem.clone())), Err(wrong(problem))),
    }
}

/// Length of a translation of three finite numbers.
fn length(translation: Option<&[f64]>) -> Option<f64> {
    let translation = translation.filter(|translation| translation.len() == 3)?;
    Some(translation.iter().map(|x| x * x).sum::<f64>().sqrt()).filter(|length| length.is_finite())
}

impl PoseEntry {
    /// Distance from the camera in the file's unit, if it can be read.
    pub(super) fn distance(&self) -> Option<f64> {
        length(self.translation_mm.as_deref())
    }

    pub(super) fn pose(&self, place: usize) -> Result<Pose, ImageProblem> {
        let rotation = self.numbers("cam_R_m2c", self.rotation.as_deref(), place)?;
        let translation: [f64; 3] = self.numbers("cam_t_m2c", self.translation_mm.as_deref(), place)?;
        Pose::from_row_major(rotation, translation.map(|millimetres| millimetres * METRES_PER_MILLIMETRE))
            .map_err(|source| ImageProblem::Pose { obj_id: self.obj_id, place, source })
    }

    /// A box; `None` of an object of which nothing is seen: BOP states -1 four times.
    pub(super) fn bounding_box(
        &self,
        field: &'static str,
        values: Option<&[f64]>,
        place: usize,
    ) -> Result<Option<BoundingBox>, ImageProblem> {
        let stated: [f64; 4] = self.numbers(field, values, place)?;
        if !stated.iter().all(|value| value.is_finite()) {
            return Err(self.field(field, place, "has a value that is not finite".into()));
        }
        let [_, _, width, height] = stated;
        Ok((width > 0.0 && height > 0.0).then(|| stated.into()))
    }

    /// A fraction, if one is stated.
    pub(super) fn visible_fraction(&self, stated: Option<f64>, place: usize) -> Result<Option<f64>, ImageProblem> {
        match stated {
            Some(value) if !(0.0..=1.0).contains(&value) => {
                Err(self.field("visib_fract", place, format!("is {value}; it must be between 0 and 1")))
            }
            stated => Ok(stated),
        }
    }

    fn numbers<const N: usize>(
        &self,
        field: &'static str,
        values: Option<&[f64]>,
        place: usize,
    ) -> Result<[f64; N], ImageProblem> {
        let values = values.ok_or_else(|| self.field(field, place, "is missing".into()))?;
        let wrong = |_| self.field(field, place, format!("has {} numbers instead of {N}", values.len()));
        values.try_into().map_err(wrong)
    }

    fn field(&self, field: &'static str, place: usize, reason: String) -> ImageProblem {
        ImageProblem::Field { obj_id: self.obj_id, place, field, reason }
    }
}
