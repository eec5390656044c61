//! Registered rigs.

use posed_core::geometry::Camera;
use serde::Serialize;
use utoipa::ToSchema;

use super::forms::{CameraForm, PoseForm, PoseSchema};
use crate::model::{PoseFile, Rig, RigCamera};

/// Cameras that are fixed to each other, as in the file of the rig. Cameras that the file names are written out.
#[derive(Serialize, ToSchema)]
#[schema(as = Rig)]
pub(crate) struct RigReport {
    /// In the order of the images that a request sends.
    cameras: Vec<RigCameraReport>,
}

/// One of them.
#[derive(Serialize, ToSchema)]
#[schema(as = RigCamera)]
struct RigCameraReport {
    #[schema(value_type = CameraForm)]
    camera: Camera,
    #[schema(value_type = PoseSchema)]
    rig_from_camera: PoseForm,
    /// Of `rig_from_camera`, along the axes of the rig. Absent if the file states none: standard deviations of 1 mm and 0.1 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<[[f64; 6]; 6]>,
}

impl From<&Rig> for RigReport {
    fn from(rig: &Rig) -> Self {
        Self { cameras: rig.cameras.iter().map(Into::into).collect() }
    }
}

impl From<&RigCamera> for RigCameraReport {
    fn from(camera: &RigCamera) -> Self {
        Self {
            camera: camera.camera.clone(),
            rig_from_camera: PoseFile::from(&camera.rig_from_camera).into(),
            covariance: camera.covariance.map(|covariance| covariance.transpose().into()),
        }
    }
}
