use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A pinhole camera. Its parameters belong to the posted image, in that image's pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "CameraFile", into = "CameraFile")]
pub struct Camera {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Image size in pixels that the parameters were calibrated for, if known.
    size: Option<(u32, u32)>,
}

/// Camera parameters that cannot describe a camera.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CameraError {
    #[error("camera field '{field}' is {value}; a focal length must be a positive number of pixels below 1e6")]
    FocalLength { field: &'static str, value: f64 },
    #[error("camera field '{field}' is {value}; the principal point must be a number of pixels between -1e5 and 1e5")]
    PrincipalPoint { field: &'static str, value: f64 },
    #[error("camera fields 'width' and 'height' must both be given, and positive")]
    Size,
    #[error(
        "camera is calibrated for {calibrated_width}x{calibrated_height} pixels but the image is {width}x{height}; \
         post the image as the camera took it, or a camera file for this size"
    )]
    ImageSize { calibrated_width: u32, calibrated_height: u32, width: u32, height: u32 },
    #[error("camera model 'pinhole' has no distortion, but {0} coefficients were given; undistort the image first")]
    Distortion(usize),
}

/// The `*.camera.json` form.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    model: CameraModel,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    width: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    height: Option<u32>,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    distortion: Vec<f64>,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum CameraModel {
    Pinhole,
}

impl Camera {
    /// # Errors
    /// When a focal length is not a positive number or the principal point is far outside any image.
    pub fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Self, CameraError> {
        for (field, value) in [("fx", fx), ("fy", fy)] {
            if !(value > 0.0 && value < 1e6) {
                return Err(CameraError::FocalLength { field, value });
            }
        }
        for (field, value) in [("cx", cx), ("cy", cy)] {
            if value.is_nan() || value.abs() >= 1e5 {
                return Err(CameraError::PrincipalPoint { field, value });
            }
        }
        Ok(Self { fx, fy, cx, cy, size: None })
    }

    /// States the image size (pixels) that the parameters belong to.
    ///
    /// # Errors
    /// When a side is 0.
    pub fn with_size(mut self, width: u32, height: u32) -> Result<Self, CameraError> {
        if width == 0 || height == 0 {
            return Err(CameraError::Size);
        }
        self.size = Some((width, height));
        Ok(self)
    }

    /// # Errors
    /// When the camera was calibrated for another image size.
    pub fn check_image_size(&self, width: u32, height: u32) -> Result<(), CameraError> {
        match self.size {
            Some((calibrated_width, calibrated_height)) if (calibrated_width, calibrated_height) != (width, height) => {
                Err(CameraError::ImageSize { calibrated_width, calibrated_height, width, height })
            }
            Some(_) | None => Ok(()),
        }
    }

    /// Focal lengths `(fx, fy)` in pixels.
    #[must_use]
    pub fn focal(&self) -> Vector2<f64> {
        Vector2::new(self.fx, self.fy)
    }

    /// Pixels of a point in the camera frame (metres); `None` where it is not in front of the camera.
    #[must_use]
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        let depth = point_in_camera.z;
        (depth > 1e-9).then(|| {
            Vector2::new(self.fx * point_in_camera.x / depth + self.cx, self.fy * point_in_camera.y / depth + self.cy)
        })
    }

    /// The point of the plane z = 1 that projects to a pixel.
    #[must_use]
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }
}

impl TryFrom<CameraFile> for Camera {
    type Error = CameraError;

    fn try_from(file: CameraFile) -> Result<Self, CameraError> {
        let CameraModel::Pinhole = file.model;
        if !file.distortion.is_empty() {
            return Err(CameraError::Distortion(file.distortion.len()));
        }
        let camera = Self::pinhole(file.fx, file.fy, file.cx, file.cy)?;
        match (file.width, file.height) {
            (None, None) => Ok(camera),
            (Some(width), Some(height)) => camera.with_size(width, height),
            (Some(_), None) | (None, Some(_)) => Err(CameraError::Size),
        }
    }
}

impl From<Camera> for CameraFile {
    fn from(camera: Camera) -> Self {
        Self {
            model: CameraModel::Pinhole,
            width: camera.size.map(|size| size.0),
            height: camera.size.map(|size| size.1),
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            distortion: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn unproject_undoes_project(x in -1.0..1.0f64, y in -1.0..1.0f64, z in 0.1..5.0f64) {
            let camera = Camera::pinhole(612.0, 598.0, 319.5, 239.5).unwrap();
            let pixel = camera.project(&Vector3::new(x, y, z)).unwrap();
            let ray = camera.unproject(&pixel);
            prop_assert!((ray - Vector2::new(x / z, y / z)).norm() < 1e-12);
        }
    }

    #[test]
    fn points_behind_the_camera_have_no_pixel() {
        let camera = Camera::pinhole(600.0, 600.0, 0.0, 0.0).unwrap();
        assert_eq!(camera.project(&Vector3::new(0.1, 0.1, -1.0)), None);
        assert_eq!(camera.project(&Vector3::new(0.1, 0.1, 0.0)), None);
    }

    #[test]
    fn bad_parameters_name_their_field() {
        let error = |json: &str| serde_json::from_str::<Camera>(json).unwrap_err().to_string();
        assert!(error(r#"{"model":"pinhole","fx":-1,"fy":1,"cx":0,"cy":0}"#).contains("'fx'"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":1e9}"#).contains("'cy'"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0,"width":5}"#).contains("'height'"));
        assert!(error(r#"{"model":"pinhole","fx":1,"fy":1,"cx":0,"cy":0,"k1":0}"#).contains("k1"));
        assert!(error(r#"{"model":"opencv","fx":1,"fy":1,"cx":0,"cy":0}"#).contains("opencv"));
        assert!(Camera::pinhole(f64::NAN, 1.0, 0.0, 0.0).is_err());
    }
}
