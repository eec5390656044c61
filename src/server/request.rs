//! What a request may ask for, on either protocol.

use serde::Deserialize;
use utoipa::ToSchema;

use super::Shared;
use super::api::json::{CameraForm, PoseForm};
use super::failure::{Failure, FailureKind};
use crate::estimator::{CallerFrames, Selection};
use crate::model::ObjectModel;
use posed_core::geometry::{Camera, Pose, PoseError};

const MAX_MARK_CHARS: usize = 64;

/// The part `request` of a multipart body. Unknown fields are refused.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct EstimateRequest {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoice)]
    pub camera: Option<serde_json::Value>,
    /// Names of the objects to look for; all calibrated ones by default.
    pub objects: Option<Vec<String>>,
    /// At most so many of each object.
    #[schema(minimum = 1)]
    pub max_instances: Option<usize>,
    /// Poses with less confidence are left out, 0..1.
    #[schema(minimum = 0, maximum = 1)]
    pub min_confidence: Option<f64>,
    /// The camera's pose in the world: then poses come in the world's frame, too.
    pub world_from_camera: Option<PoseForm>,
    /// The camera's pose in the robot's base: then poses come in the base's frame, too.
    pub base_from_camera: Option<PoseForm>,
    /// Your own mark of the image, such as its capture time: given back as it is, at most 64 characters.
    pub captured_at: Option<String>,
}

/// For the documentation: which JSON a camera may be.
#[derive(ToSchema)]
#[schema(as = CameraChoice)]
#[expect(dead_code, reason = "describes JSON")]
pub(super) enum CameraChoice {
    #[schema(title = "id")]
    Id(String),
    #[schema(title = "camera")]
    Camera(CameraForm),
}

/// A request, checked.
#[derive(Clone, Debug)]
pub(super) struct Options {
    pub camera: Camera,
    pub selection: Selection,
    pub frames: CallerFrames,
    pub captured_at: Option<String>,
}

impl EstimateRequest {
    pub(super) fn check(self, app: &Shared) -> Result<Options, Failure> {
        let camera = self.camera.ok_or_else(no_camera)?;
        let frame = |field, file: Option<PoseForm>| file.map(|file| pose(field, file)).transpose();
        let options = Options {
            camera: choose_camera(&camera, app)?,
            selection: Selection {
                objects: self.objects,
                max_instances: self.max_instances,
                min_confidence: self.min_confidence.unwrap_or(0.0),
            },
            frames: CallerFrames {
                world_from_camera: frame("world_from_camera", self.world_from_camera)?,
                base_from_camera: frame("base_from_camera", self.base_from_camera)?,
            },
            captured_at: self.captured_at,
        };
        options.check(app)
    }
}

impl Options {
    /// What both protocols check.
    pub(super) fn check(self, app: &Shared) -> Result<Self, Failure> {
        let Selection { objects, max_instances, min_confidence } = &self.selection;
        for name in objects.iter().flatten() {
            known_object(name, app)?;
            if !app.is_calibrated(name) {
                let message =
                    format!("object {name:?} is not calibrated; measure its offset with `posed calibrate {name}`");
                return Err(Failure::new(FailureKind::NotCalibrated, message));
            }
        }
        if *max_instances == Some(0) {
            return Err(invalid("field 'max_instances' is 0; leave it out, or give at least 1"));
        }
        if !(0.0..=1.0).contains(min_confidence) {
            return Err(invalid(&format!("field 'min_confidence' is {min_confidence}; it must lie between 0 and 1")));
        }
        if self.captured_at.as_ref().is_some_and(|mark| mark.chars().count() > MAX_MARK_CHARS) {
            return Err(invalid(&format!("field 'captured_at' has more than {MAX_MARK_CHARS} characters")));
        }
        Ok(self)
    }
}

pub(super) fn invalid(message: &str) -> Failure {
    Failure::new(FailureKind::InvalidRequest, message)
}

pub(super) fn no_camera() -> Failure {
    invalid("no camera: name a registered one, or give its parameters")
}

/// A registered camera by its id, or the camera that the JSON describes.
pub(super) fn choose_camera(json: &serde_json::Value, app: &Shared) -> Result<Camera, Failure> {
    match json.as_str() {
        Some(id) => registered_camera(id, app),
        None => Camera::deserialize(json).map_err(|error| invalid(&format!("field 'camera': {error}"))),
    }
}

pub(super) fn registered_camera(id: &str, app: &Shared) -> Result<Camera, Failure> {
    app.cameras.get(id).cloned().ok_or_else(|| Failure::unknown_camera(id, &app.cameras))
}

pub(super) fn known_object<'a>(name: &str, app: &'a Shared) -> Result<&'a ObjectModel, Failure> {
    app.library.object(name).ok_or_else(|| {
        let known: Vec<&str> = app.library.known().map(|object| object.manifest.name.as_str()).collect();
        let message = format!("no object {name:?}; known objects: {}", known.join(", "));
        Failure::new(FailureKind::UnknownObject, message)
    })
}

pub(super) fn pose(field: &str, form: impl TryInto<Pose, Error = PoseError>) -> Result<Pose, Failure> {
    form.try_into().map_err(|error| invalid(&format!("field '{field}' is no pose: {error}")))
}
