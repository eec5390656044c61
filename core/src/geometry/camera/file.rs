//! The `*.camera.json` form.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::lens::Model;
use super::model::{Camera, CameraError};

/// A camera as JSON. Parameters are in pixels of an image of `width` x `height`, pixel centres at integers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFile {
    /// Without it the camera is a pinhole.
    #[serde(default)]
    model: CameraModel,
    /// Of the image that the parameters belong to. Without it no image can be found to be of another size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    width: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    height: Option<u32>,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Of the camera matrix, pixels. Must be 0: it is read so that others are refused with a reason.
    #[serde(default, skip_serializing)]
    skew: f64,
    /// `opencv`: 4, 5, 8, 12 or 14 coefficients `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [0 0]]]]`; `fisheye`: 4.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    distortion: Vec<f64>,
}

/// OpenCV's lens models.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraModel {
    /// No distortion.
    #[default]
    Pinhole,
    /// Radial, tangential and thin prism terms.
    OpenCv,
    /// Kannala and Brandt.
    Fisheye,
}

impl TryFrom<CameraFile> for Camera {
    type Error = CameraError;

    fn try_from(file: CameraFile) -> Result<Self, CameraError> {
        if file.skew != 0.0 {
            return Err(CameraError::Skew(file.skew));
        }
        let camera = Self::pinhole(file.fx, file.fy, file.cx, file.cy)?;
        let camera = match file.model {
            CameraModel::Pinhole if file.distortion.is_empty() => camera,
            CameraModel::Pinhole => return Err(CameraError::PinholeDistortion(file.distortion.len())),
            CameraModel::OpenCv => camera.with_opencv_distortion(&file.distortion)?,
            CameraModel::Fisheye => camera.with_fisheye_distortion(&file.distortion)?,
        };
        match (file.width, file.height) {
            (None, None) => Ok(camera),
            (Some(width), Some(height)) => camera.with_size(width, height),
            (Some(_), None) | (None, Some(_)) => Err(CameraError::Size),
        }
    }
}

impl From<Camera> for CameraFile {
    fn from(camera: Camera) -> Self {
        let (model, distortion) = match camera.lens.model() {
            Model::Pinhole => (CameraModel::Pinhole, Vec::new()),
            Model::OpenCv { coefficients, stated } => (CameraModel::OpenCv, coefficients[..*stated].to_vec()),
            Model::Fisheye(coefficients) => (CameraModel::Fisheye, coefficients.to_vec()),
        };
        Self {
            model,
            width: camera.size.map(|size| size.0),
            height: camera.size.map(|size| size.1),
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            skew: 0.0,
            distortion,
        }
    }
}

impl Serialize for Camera {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        CameraFile::from(self.clone()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Camera {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        CameraFile::deserialize(deserializer)?.try_into().map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera::model::tests::any_camera;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn json_round_trip(camera in any_camera()) {
            let json = serde_json::to_string(&camera).unwrap();
            prop_assert_eq!(serde_json::from_str::<Camera>(&json).unwrap(), camera);
        }
    }

    /// As `calibrateCamera` writes it with every flag but the tilted one, and as other tools write a matrix without skew.
    #[test]
    fn zeros_that_say_nothing_are_read() {
        let read = |more: &str, zeros: &str| {
            let text = format!(
                r#"{{"model":"opencv","fx":600,"fy":600,"cx":320,"cy":240,{more}"distortion":[0.1,0,0,0,0,0,0,0,0,0,0,0{zeros}]}}"#
            );
            serde_json::from_str::<Camera>(&text).unwrap()
        };
        assert_eq!(read(r#""skew":0,"#, ",0,-0.0"), read("", ""));
    }

    /// A lens must be named: coefficients alone may be those of either model.
    #[test]
    fn a_camera_without_a_model_is_a_pinhole() {
        let read =
            |more: &str| serde_json::from_str::<Camera>(&format!(r#"{{"fx":600,"fy":600,"cx":320,"cy":240{more}}}"#));
        assert_eq!(read("").unwrap(), Camera::pinhole(600.0, 600.0, 320.0, 240.0).unwrap());
        assert!(read(r#","distortion":[0.1,0,0,0]"#).unwrap_err().to_string().contains("pinhole"));
    }

    #[test]
    fn bad_parameters_name_their_field() {
        let error = |json: &str| serde_json::from_str::<Camera>(json).unwrap_err().to_string();
        assert!(error(r#"{"model":"pinhole","fx":-1,"fy":1,"cx":0,"cy":0}"#).contains("'fx'"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":1e9}"#).contains("'cy'"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0,"width":5}"#).contains("'height'"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0,"k1":0}"#).contains("k1"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0,"distortion":[0.1]}"#).contains("pinhole"));
        assert!(error(r#"{"model":"opencv","fx":1,"fy":1,"cx":0,"cy":0}"#).contains("4, 5, 8, 12 or 14"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0,"skew":0.4}"#).contains("'skew' is 0.4"));
        let tilted = r#"{"model":"opencv","fx":1,"fy":1,"cx":0,"cy":0,"distortion":[0,0,0,0,0,0,0,0,0,0,0,0,0,0.02]}"#;
        assert!(error(tilted).contains("tau_y = 0.02"));
        assert!(error(r#"{"model":"fisheye","fx":1,"fy":1,"cx":0,"cy":0,"distortion":[1]}"#).contains("needs 4"));
        assert!(error(r#"{"model":"tilted","fx":1,"fy":1,"cx":0,"cy":0}"#).contains("tilted"));
    }
}
