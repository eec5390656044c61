//! Options of a request whose body is an image.

use posed_core::geometry::Camera;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::estimator::CallerFrames;
use crate::server::api::json::RawForm;
use crate::server::service::{CameraChoice, Failure, PoseRequest};
use crate::vision::RawLayout;

/// Options of a request whose body is an image.
#[derive(Debug, Default, Deserialize, PartialEq, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(default, deny_unknown_fields)]
pub(super) struct EstimateQuery {
    /// Id of a registered camera; else give `fx`, `fy`, `cx`, `cy`.
    camera: Option<String>,
    /// Focal lengths and principal point of a pinhole camera, pixels of the posted image.
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    /// Names of the objects to look for, with commas; all calibrated ones by default.
    objects: Option<String>,
    /// At most this many of each object.
    max_instances: Option<usize>,
    /// Poses with less confidence are left out, 0..1.
    min_confidence: Option<f64>,
    /// Your own mark of the image, given back as it is.
    captured_at: Option<String>,
    /// The body is a raw frame of this encoding, as ROS `sensor_msgs/Image` names it, whatever its content type.
    #[param(example = "bgr8")]
    encoding: Option<String>,
    /// Of a raw frame, pixels.
    width: Option<u32>,
    /// Of a raw frame, pixels.
    height: Option<u32>,
    /// Bytes of a raw frame's row; by default as many as its pixels take.
    step: Option<u32>,
}

impl EstimateQuery {
    pub(super) fn is_raw(&self) -> bool {
        self.encoding.is_some()
    }

    /// What is asked, and the layout of a raw frame.
    pub(super) fn translate(self) -> Result<(PoseRequest, Option<RawLayout>), Failure> {
        let raw = self.raw()?;
        let camera = match (self.camera, [self.fx, self.fy, self.cx, self.cy]) {
            (Some(id), [None, None, None, None]) => CameraChoice::Registered(id),
            (None, [Some(fx), Some(fy), Some(cx), Some(cy)]) => CameraChoice::Given(Camera::pinhole(fx, fy, cx, cy)?),
            (Some(_), _) => return Err(Failure::invalid("give either 'camera' or 'fx', 'fy', 'cx', 'cy', not both")),
            (None, _) => {
                let message = "no camera: give 'camera' (an id) or all of 'fx', 'fy', 'cx', 'cy' (pixels)";
                return Err(Failure::invalid(message));
            }
        };
        let request = PoseRequest {
            camera: Some(camera),
            objects: self.objects.map(|names| names.split(',').map(|name| name.trim().to_owned()).collect()),
            max_instances: self.max_instances,
            min_confidence: self.min_confidence,
            frames: CallerFrames::default(),
            captured_at: self.captured_at,
        };
        Ok((request, raw))
    }

    fn raw(&self) -> Result<Option<RawLayout>, Failure> {
        match (&self.encoding, self.width, self.height) {
            (None, None, None) if self.step.is_none() => Ok(None),
            (Some(encoding), Some(width), Some(height)) => {
                let form = RawForm { encoding: encoding.clone(), width, height, step: self.step };
                RawLayout::try_from(form).map(Some).map_err(|error| Failure::invalid(error.to_string()))
            }
            (Some(_), _, _) => Err(Failure::invalid("a raw frame needs 'encoding', 'width' and 'height' (pixels)")),
            (None, _, _) => {
                Err(Failure::invalid("'width', 'height' and 'step' are for raw frames; give 'encoding', too"))
            }
        }
    }
}
