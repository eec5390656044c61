//! Options of a request whose body is an image.

use posed_core::geometry::Camera;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::estimator::CallerFrames;
use crate::server::api::json::RawForm;
use crate::server::service::{CameraChoice, Failure, PoseRequest, RequestedBox};
use crate::vision::RawLayout;

/// Options of a request whose body is an image.
#[derive(Debug, Default, Deserialize, PartialEq, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(default, deny_unknown_fields)]
pub(super) struct EstimateQuery {
    /// Id of a registered camera. Set this, or `fx`, `fy`, `cx` and `cy`.
    camera: Option<String>,
    /// Horizontal focal length of a pinhole camera, pixels of the posted image.
    fx: Option<f64>,
    /// Vertical focal length.
    fy: Option<f64>,
    /// Principal point, x.
    cx: Option<f64>,
    /// Principal point, y.
    cy: Option<f64>,
    /// Names of the objects to look for, separated by commas. Omit this to look for all calibrated objects.
    objects: Option<String>,
    /// Where the objects are, from a detector of your own, which then replaces the server's: `OBJECT:X,Y,WIDTH,HEIGHT` in
    /// pixels, separated by semicolons.
    #[param(example = "cube:310,120,90,80;motor:20.5,200,130,110")]
    boxes: Option<String>,
    /// Maximum number of poses of each object. Omit this for no maximum.
    max_instances: Option<usize>,
    /// Minimum confidence, 0..1. The answer omits poses below it.
    min_confidence: Option<f64>,
    /// Whether an image of another size than the camera's is its full frame, resized: the parameters are then scaled.
    allow_resize: bool,
    /// Your label for the image, such as its capture time. The answer repeats it. At most 64 characters.
    captured_at: Option<String>,
    /// Encoding of a raw frame, with its name in ROS `sensor_msgs/Image`. If set, the body is a raw frame whatever its
    /// content type. `GET /v1/limits` lists the encodings.
    #[param(example = "bgr8")]
    encoding: Option<String>,
    /// Width of a raw frame, pixels.
    width: Option<u32>,
    /// Height of a raw frame, pixels.
    height: Option<u32>,
    /// Bytes from one row of a raw frame to the next. Omit this if rows have no padding.
    step: Option<u32>,
}

impl EstimateQuery {
    pub(super) fn is_raw(&self) -> bool {
        self.encoding.is_some()
    }

    /// Splits the query into the request and the layout of a raw frame.
    pub(super) fn translate(self) -> Result<(PoseRequest, Option<RawLayout>), Failure> {
        let raw = self.raw()?;
        let camera = match (self.camera, [self.fx, self.fy, self.cx, self.cy]) {
            (Some(id), [None, None, None, None]) => CameraChoice::Registered(id),
            (None, [Some(fx), Some(fy), Some(cx), Some(cy)]) => CameraChoice::Given(Camera::pinhole(fx, fy, cx, cy)?),
            (Some(_), _) => return Err(Failure::invalid("set either 'camera' or 'fx', 'fy', 'cx' and 'cy', not both")),
            (None, _) => {
                let message = "no camera; set 'camera' (an id), or all of 'fx', 'fy', 'cx' and 'cy' (pixels)";
                return Err(Failure::invalid(message));
            }
        };
        let request = PoseRequest {
            camera: Some(camera),
            objects: self.objects.map(|names| {
                names.split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
            }),
            max_instances: self.max_instances,
            min_confidence: self.min_confidence,
            allow_resize: self.allow_resize,
            boxes: self.boxes.as_deref().map(boxes).transpose()?,
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
            (Some(_), _, _) => {
                Err(Failure::invalid("a raw frame needs 'encoding', 'width' and 'height' (pixels); set all three"))
            }
            (None, _, _) => Err(Failure::invalid(
                "'width', 'height' and 'step' are for raw frames only; add 'encoding', or remove them",
            )),
        }
    }
}

/// Boxes as a query has them.
fn boxes(text: &str) -> Result<Vec<RequestedBox>, Failure> {
    let one = |text: &str| {
        let (object, numbers) = text.split_once(':')?;
        let numbers: Vec<f64> = numbers.split(',').map(|number| number.trim().parse().ok()).collect::<Option<_>>()?;
        Some(RequestedBox { object: object.trim().to_owned(), box_px: numbers.try_into().ok()? })
    };
    let wrong = |text: &str| {
        Failure::invalid(format!(
            "field 'boxes' has {text:?}; give OBJECT:X,Y,WIDTH,HEIGHT in pixels, separated by ';'"
        ))
    };
    let parts = text.split(';').map(str::trim).filter(|part| !part.is_empty());
    parts.map(|part| one(part).ok_or_else(|| wrong(part))).collect()
}
