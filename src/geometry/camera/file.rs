//! The `*.camera.json` form.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Camera, CameraError, Lens, Model};

/// A camera as JSON. Parameters are in pixels of an image of `width` x `height`, pixel centres at integers.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Camera)]
pub struct CameraFile {
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
    /// `opencv`: 4, 5, 8 or 12 coefficients `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]`; `fisheye`: 4.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    distortion: Vec<f64>,
}

/// OpenCV's lens models.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum CameraModel {
    /// No distortion.
    Pinhole,
    /// Radial, tangential and thin prism terms.
    OpenCv,
    /// Kannala and Brandt.
    Fisheye,
}

impl TryFrom<CameraFile> for Camera {
    type Error = CameraError;

    fn try_from(file: CameraFile) -> Result<Self, CameraError> {
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
            distortion,
        }
    }
}

impl Camera {
    /// The same camera with OpenCV's lens model: `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]`.
    ///
    /// # Errors
    /// When there are not 4, 5, 8 or 12 finite coefficients.
    pub fn with_opencv_distortion(self, coefficients: &[f64]) -> Result<Self, CameraError> {
        if !matches!(coefficients.len(), 4 | 5 | 8 | 12) {
            return Err(CameraError::DistortionCount {
                model: "opencv",
                expected: "4, 5, 8 or 12",
                given: coefficients.len(),
            });
        }
        check_finite(coefficients)?;
        let mut all = [0.0; 12];
        all[..coefficients.len()].copy_from_slice(coefficients);
        Ok(Self { lens: Lens::new(Model::OpenCv { coefficients: all, stated: coefficients.len() }), ..self })
    }

    /// The same camera with OpenCV's fisheye lens model: `k1 k2 k3 k4`. Rays further than 88 degrees from the optical
    /// axis are outside its domain.
    ///
    /// # Errors
    /// When there are not 4 finite coefficients.
    pub fn with_fisheye_distortion(self, coefficients: &[f64]) -> Result<Self, CameraError> {
        let four: [f64; 4] = coefficients.try_into().map_err(|_| CameraError::DistortionCount {
            model: "fisheye",
            expected: "4",
            given: coefficients.len(),
        })?;
        check_finite(&four)?;
        Ok(Self { lens: Lens::new(Model::Fisheye(four)), ..self })
    }
}

fn check_finite(coefficients: &[f64]) -> Result<(), CameraError> {
    match coefficients.iter().position(|k| !k.is_finite()) {
        Some(index) => Err(CameraError::DistortionValue { index }),
        None => Ok(()),
    }
}
