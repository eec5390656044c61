//! What a request may ask for, on every protocol.

use posed_core::geometry::{Camera, Pose, PoseError};

use super::boxes::RequestedBox;
use super::failure::{Failure, FailureKind};
use super::state::Service;
use crate::estimator::{CallerFrames, Selection};
use crate::model::Catalogue;

const MAX_MARK_CHARS: usize = 64;
/// Names in one request; their copies wait with the image.
const MAX_OBJECTS: usize = 256;

/// A registered camera by its id, or a camera given with the request.
#[derive(Clone, Debug)]
pub(crate) enum CameraChoice {
    Registered(String),
    Given(Camera),
}

/// A request as it came, translated.
#[derive(Clone, Debug, Default)]
pub(crate) struct PoseRequest {
    pub camera: Option<CameraChoice>,
    /// Names of the objects to look for; all calibrated ones where there is no list.
    pub objects: Option<Vec<String>>,
    pub max_instances: Option<usize>,
    pub min_confidence: Option<f64>,
    pub allow_resize: bool,
    /// In place of what detectors see.
    pub boxes: Option<Vec<RequestedBox>>,
    pub frames: CallerFrames,
    /// The caller's own mark of the image.
    pub captured_at: Option<String>,
}

/// A request, checked.
#[derive(Clone, Debug)]
pub(crate) struct Options {
    pub camera: Camera,
    pub selection: Selection,
    pub frames: CallerFrames,
    pub captured_at: Option<String>,
}

impl PoseRequest {
    /// How many objects and boxes a request may have: to be asked before it is copied.
    pub(crate) fn check_counts(&self) -> Result<(), Failure> {
        RequestedBox::check_count(self.boxes.as_deref())?;
        Self::check_names(self.objects.as_deref())
    }

    /// How many objects a request may name.
    pub(crate) fn check_names(objects: Option<&[String]>) -> Result<(), Failure> {
        match objects {
            Some([]) => {
                Err(Failure::invalid("field 'objects' is empty; name at least one object, or omit it to look for all"))
            }
            Some(names) if names.len() > MAX_OBJECTS => {
                Err(Failure::invalid(format!("field 'objects' has more than {MAX_OBJECTS} names")))
            }
            Some(_) | None => Ok(()),
        }
    }
}

impl Service {
    /// Checks a request against what there is.
    pub(crate) fn options(&self, request: PoseRequest) -> Result<Options, Failure> {
        request.check_counts()?;
        let PoseRequest { camera, objects, max_instances, min_confidence, allow_resize, boxes, frames, captured_at } =
            request;
        let no_camera = || Failure::invalid("no camera; set the id of a registered camera, or its parameters");
        let camera = self.camera(camera.ok_or_else(no_camera)?)?;
        if objects.is_some() && boxes.is_some() {
            return Err(Failure::invalid("set either 'objects' or 'boxes', not both: boxes name their objects"));
        }
        let catalogue = self.catalogue();
        for name in objects.iter().flatten().chain(boxes.iter().flatten().map(|one| &one.object)) {
            check_calibrated(&catalogue, name)?;
        }
        let boxes = boxes.map(|boxes| boxes.into_iter().enumerate().map(|(place, one)| one.checked(place)).collect());
        let boxes = boxes.transpose()?;
        if max_instances == Some(0) {
            return Err(Failure::invalid("field 'max_instances' is 0; set it to at least 1, or omit it"));
        }
        let min_confidence = min_confidence.unwrap_or(0.0);
        if !(0.0..=1.0).contains(&min_confidence) {
            let message = format!("field 'min_confidence' is {min_confidence}; it must be between 0 and 1");
            return Err(Failure::invalid(message));
        }
        if captured_at.as_ref().is_some_and(|mark| mark.chars().count() > MAX_MARK_CHARS) {
            let message = format!("field 'captured_at' exceeds the limit of {MAX_MARK_CHARS} characters");
            return Err(Failure::invalid(message));
        }
        let selection = Selection { objects, max_instances, min_confidence, allow_resize, boxes };
        Ok(Options { camera, selection, frames, captured_at })
    }

    pub(super) fn camera(&self, choice: CameraChoice) -> Result<Camera, Failure> {
        match choice {
            CameraChoice::Given(camera) => Ok(camera),
            CameraChoice::Registered(id) => {
                self.cameras.get(&id).cloned().ok_or_else(|| Failure::unknown_camera(&id, &self.cameras))
            }
        }
    }
}

/// Whether poses of an object can be asked for.
fn check_calibrated(catalogue: &Catalogue, name: &str) -> Result<(), Failure> {
    let Catalogue { library, references } = catalogue;
    library.object(name).ok_or_else(|| Failure::unknown_object(name, library))?;
    if references.get(name).is_some() {
        return Ok(());
    }
    let problem = references.problem(name);
    let problem = problem.unwrap_or_else(|| format!("calibrate it with `posed calibrate {name}`"));
    Err(Failure::new(FailureKind::NotCalibrated, format!("object {name:?} is not calibrated; {problem}")))
}

impl Failure {
    /// A pose among a request's fields, or what is wrong with it.
    pub(crate) fn or_pose(field: &str, form: impl TryInto<Pose, Error = PoseError>) -> Result<Pose, Self> {
        form.try_into().map_err(|error| Self::invalid(format!("field '{field}' is not a pose: {error}")))
    }
}
