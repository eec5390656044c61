//! The types that requests are built from.

use std::fmt;

use posed_core::geometry::{Camera, Pose, PoseError};
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, Deserialize, Deserializer, MapAccess, Visitor};
use utoipa::ToSchema;

use crate::model::PoseFile;
use crate::server::service::{CameraChoice, Failure, RequestedBox};
use crate::vision::{RawError, RawLayout};

/// A pose in a request.
#[derive(Clone, Copy, Debug, serde::Deserialize, serde::Serialize)]
#[serde(from = "PoseFile")]
pub(crate) struct PoseForm {
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
}

/// A pose: `rotation_xyzw` and `translation_m`, or `matrix`, or all of them as an answer has them.
#[derive(ToSchema)]
#[schema(as = Pose)]
#[expect(dead_code, reason = "describes the JSON form of `PoseFile`")]
pub(crate) struct PoseSchema {
    /// Unit quaternion x, y, z, w.
    rotation_xyzw: Option<[f64; 4]>,
    /// Metres.
    translation_m: Option<[f64; 3]>,
    /// Homogeneous 4x4 matrix, row-major, metres.
    matrix: Option<[[f64; 4]; 4]>,
}

impl From<PoseFile> for PoseForm {
    fn from(PoseFile { rotation_xyzw, translation_m }: PoseFile) -> Self {
        Self { rotation_xyzw, translation_m }
    }
}

impl TryFrom<PoseForm> for Pose {
    type Error = PoseError;

    fn try_from(form: PoseForm) -> Result<Self, PoseError> {
        Self::from_quaternion_xyzw(form.rotation_xyzw, form.translation_m)
    }
}

/// A camera. Parameters are in pixels of an image of `width` x `height`, with pixel centres at integer coordinates.
#[derive(ToSchema)]
#[schema(as = Camera)]
#[expect(dead_code, reason = "describes the JSON form of `posed_core`'s camera; a test compares them")]
pub(crate) struct CameraForm {
    /// By default `pinhole`.
    model: Option<CameraModelForm>,
    /// Size of the image that the parameters are calibrated for. An image of another size is rejected, unless the
    /// request sets `allow_resize`. Omit both to skip this check. For a region of the frame, keep `fx` and `fy`, and
    /// subtract the region's left and top edges from `cx` and `cy`.
    width: Option<u32>,
    height: Option<u32>,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// For `opencv`, 4, 5, 8, 12 or 14 coefficients `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]]`. The tilts
    /// must be 0. For `fisheye`, 4.
    distortion: Option<Vec<f64>>,
}

/// OpenCV's lens models.
#[derive(ToSchema)]
#[schema(as = CameraModel, rename_all = "lowercase")]
#[expect(dead_code, reason = "describes JSON")]
enum CameraModelForm {
    /// No distortion.
    Pinhole,
    /// Radial, tangential and thin prism terms.
    OpenCv,
    /// Kannala-Brandt model.
    Fisheye,
}

/// The id of a registered camera, or the parameters of a camera.
#[derive(ToSchema)]
#[schema(as = CameraChoice)]
#[expect(dead_code, reason = "describes JSON")]
pub(crate) enum CameraChoiceForm {
    #[schema(title = "id")]
    Id(String),
    #[schema(title = "camera")]
    Camera(CameraForm),
}

impl<'de> Deserialize<'de> for CameraChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ChoiceVisitor)
    }
}

/// Distinguishes an id from a camera by the JSON type, so that errors inside a camera are reported as such.
struct ChoiceVisitor;

impl<'de> Visitor<'de> for ChoiceVisitor {
    type Value = CameraChoice;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the id of a registered camera, or the parameters of a camera")
    }

    fn visit_str<E: de::Error>(self, id: &str) -> Result<CameraChoice, E> {
        Ok(CameraChoice::Registered(id.to_owned()))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<CameraChoice, A::Error> {
        let camera = Camera::deserialize(MapAccessDeserializer::new(map));
        camera.map(CameraChoice::Given).map_err(|error| de::Error::custom(format!("field 'camera': {error}")))
    }
}

/// An object, and where it is.
#[derive(Clone, Debug, serde::Deserialize, ToSchema)]
#[schema(as = ObjectBox)]
#[serde(deny_unknown_fields)]
pub(crate) struct BoxForm {
    pub object: String,
    /// Box of its visible part: x, y, width, height in pixels of the posted image. What lies beyond the image is cut off.
    pub box_px: [f64; 4],
}

impl BoxForm {
    pub(super) fn all(boxes: Option<Vec<Self>>) -> Option<Vec<RequestedBox>> {
        let requested = |Self { object, box_px }| RequestedBox { object, box_px };
        boxes.map(|boxes| boxes.into_iter().map(requested).collect())
    }
}

/// The layout of a raw frame, as in ROS `sensor_msgs/Image`.
#[derive(Clone, Debug, serde::Deserialize, ToSchema)]
#[schema(as = RawLayout)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawForm {
    /// One of `raw_encodings` in `GET /v1/limits`.
    #[schema(example = "bgr8")]
    pub encoding: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Bytes from one row to the next. Omit this if rows have no padding.
    pub step: Option<u32>,
}

impl TryFrom<RawForm> for RawLayout {
    type Error = RawError;

    fn try_from(form: RawForm) -> Result<Self, RawError> {
        let RawForm { encoding, width, height, step } = form;
        Ok(Self { encoding: encoding.parse()?, width, height, step })
    }
}

impl RawForm {
    /// The layout, or a failure that names the field `raw`.
    pub(super) fn layout(self) -> Result<RawLayout, Failure> {
        self.try_into().map_err(|error: RawError| Failure::invalid(format!("field 'raw': {error}")))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use utoipa::PartialSchema as _;

    use super::*;

    #[test]
    fn the_described_camera_is_the_one_that_is_read() {
        let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap().with_fisheye_distortion(&[0.1; 4]).unwrap();
        let json = serde_json::to_value(camera.with_size(640, 480).unwrap()).unwrap();
        let schema = serde_json::to_value(CameraForm::schema()).unwrap();
        let keys = |value: &serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
        assert_eq!(keys(&json), keys(&schema["properties"]));
        let models = serde_json::to_value(CameraModelForm::schema()).unwrap();
        for model in models["enum"].as_array().unwrap() {
            let mut other = json.clone();
            other["model"] = model.clone();
            let known = serde_json::from_value::<Camera>(other);
            assert!(known.is_ok() || !known.unwrap_err().to_string().contains("unknown variant"));
        }
    }
}
