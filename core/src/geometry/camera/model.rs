use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use thiserror::Error;

use super::lens::{Lens, Model};

/// Points nearer to the camera's plane than this (metres) count as not in front of it.
const MIN_DEPTH_M: f64 = 1e-9;

/// A camera: pinhole, or with one of OpenCV's lens models. Its parameters belong to the posted image, in that image's
/// pixels. Equation: `pixel = (fx, fy) * lens(x / z, y / z) + (cx, cy)` for a point `(x, y, z)` in frame `camera`.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub(super) fx: f64,
    pub(super) fy: f64,
    pub(super) cx: f64,
    pub(super) cy: f64,
    pub(super) lens: Lens,
    /// Image size in pixels that the parameters were calibrated for, if known.
    pub(super) size: Option<(u32, u32)>,
}

/// A point or a pixel that a camera cannot map.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ProjectionError {
    #[error("point is not in front of the camera: its depth is {depth_m} m")]
    BehindCamera { depth_m: f64 },
    #[error(
        "point is outside the domain of the lens model: the distortion polynomial folds back there, or the ray is \
         more than 88 degrees from the optical axis"
    )]
    OutsideLens,
}

/// Camera parameters that cannot describe a camera.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CameraError {
    #[error("camera field '{field}' is {value}; a focal length must be a positive number of pixels below 1e6")]
    FocalLength { field: &'static str, value: f64 },
    #[error("camera field '{field}' is {value}; the principal point must be a number of pixels between -1e5 and 1e5")]
    PrincipalPoint { field: &'static str, value: f64 },
    #[error("camera fields 'width' and 'height' must both be given, and positive")]
    Size,
    #[error(
        "camera is calibrated for {calibrated_width}x{calibrated_height} pixels, but the image is {width}x{height}; give the \
         parameters of this image. Of a region, fx and fy stay, and its left and top edges are subtracted from cx and cy"
    )]
    ImageSize { calibrated_width: u32, calibrated_height: u32, width: u32, height: u32 },
    #[error(
        "camera model 'pinhole' has no distortion, but {0} coefficients are given; use model 'opencv' or 'fisheye'"
    )]
    PinholeDistortion(usize),
    #[error("camera field 'distortion' has {given} values; model '{model}' needs {expected}")]
    DistortionCount { model: &'static str, expected: &'static str, given: usize },
    #[error("camera field 'distortion': value {index} is not finite")]
    DistortionValue { index: usize },
    #[error(
        "camera field 'distortion' tilts the sensor (values 13 and 14, tau_x = {tau_x} and tau_y = {tau_y}), which is not \
         supported; calibrate without CALIB_TILTED_MODEL"
    )]
    Tilt { tau_x: f64, tau_y: f64 },
    #[error(
        "camera field 'skew' is {0}; pixels with a skew are not supported: rectify the images, or calibrate without skew"
    )]
    Skew(f64),
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
        Ok(Self { fx, fy, cx, cy, lens: Lens::new(Model::Pinhole), size: None })
    }

    /// The same camera with OpenCV's lens model: `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]]`. The tilts must
    /// be 0.
    ///
    /// # Errors
    /// When there are not 4, 5, 8, 12 or 14 finite coefficients, or the sensor is tilted.
    pub fn with_opencv_distortion(self, coefficients: &[f64]) -> Result<Self, CameraError> {
        if !matches!(coefficients.len(), 4 | 5 | 8 | 12 | 14) {
            return Err(CameraError::DistortionCount {
                model: "opencv",
                expected: "4, 5, 8, 12 or 14",
                given: coefficients.len(),
            });
        }
        check_finite(coefficients)?;
        let (coefficients, tilts) = coefficients.split_at(coefficients.len().min(12));
        if let [tau_x, tau_y] = *tilts
            && (tau_x != 0.0 || tau_y != 0.0)
        {
            return Err(CameraError::Tilt { tau_x, tau_y });
        }
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

    /// The size (pixels) that the parameters belong to, where it is stated.
    #[must_use]
    pub fn size(&self) -> Option<(u32, u32)> {
        self.size
    }

    /// The camera of an image of this size: this camera, where it states this size or none.
    ///
    /// # Errors
    /// When it states another size. Nothing tells a resized image from a region of the same shape, and the wrong guess
    /// moves every pose: see [`for_resized`](Self::for_resized).
    pub fn for_image(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        match self.size {
            Some((calibrated_width, calibrated_height)) if (calibrated_width, calibrated_height) != (width, height) => {
                Err(CameraError::ImageSize { calibrated_width, calibrated_height, width, height })
            }
            Some(_) | None => Ok(self.clone()),
        }
    }

    /// The camera of an image of this size that is the camera's full frame, resized. A lens model is not changed by a
    /// resize.
    ///
    /// # Errors
    /// When the image has another shape, as most regions have.
    pub fn for_resized(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        let Some((calibrated_width, calibrated_height)) = self.size.filter(|size| *size != (width, height)) else {
            return Ok(self.clone());
        };
        let [w, h, cw, ch] = [width, height, calibrated_width, calibrated_height].map(f64::from);
        // A resize rounds both sides to whole pixels.
        if (w * ch - h * cw).abs() > 0.5 * (cw + ch) {
            return Err(CameraError::ImageSize { calibrated_width, calibrated_height, width, height });
        }
        let scale = Vector2::new(w / cw, h / ch);
        // Pixel centres are at integers, so the image's edge, not its first pixel's centre, stays where it is.
        let centre = |c: f64, s: f64| (c + 0.5) * s - 0.5;
        Ok(Self {
            fx: self.fx * scale.x,
            fy: self.fy * scale.y,
            cx: centre(self.cx, scale.x),
            cy: centre(self.cy, scale.y),
            lens: self.lens.clone(),
            size: Some((width, height)),
        })
    }

    /// Whether its lens follows the fisheye model, which others cannot stand for beyond wide angles.
    #[must_use]
    pub fn is_fisheye(&self) -> bool {
        self.lens.is_fisheye()
    }

    /// Focal lengths `(fx, fy)` in pixels.
    #[must_use]
    pub fn focal(&self) -> Vector2<f64> {
        Vector2::new(self.fx, self.fy)
    }

    /// Principal point `(cx, cy)` in pixels.
    #[must_use]
    pub fn principal_point(&self) -> Vector2<f64> {
        Vector2::new(self.cx, self.cy)
    }

    /// Pixels of a point in frame `camera` (metres).
    ///
    /// # Errors
    /// When the point is not in front of the camera, or outside the domain of the lens model.
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Result<Vector2<f64>, ProjectionError> {
        let normalised = normalised(point_in_camera)?;
        if self.lens.is_pinhole() {
            return Ok(self.to_pixels(&normalised));
        }
        let (moved, _) = self.lens.distort(&normalised).ok_or(ProjectionError::OutsideLens)?;
        Ok(self.to_pixels(&moved))
    }

    /// The point of the plane z = 1 that projects to a pixel.
    ///
    /// # Errors
    /// When no ray within the domain of the lens model meets the pixel.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        self.unproject_with_jacobian(pixel).map(|(point, _)| point)
    }

    /// As [`Camera::unproject`], with the derivative of the point by the pixel (1/px).
    ///
    /// # Errors
    /// As [`Camera::unproject`].
    pub fn unproject_with_jacobian(
        &self,
        pixel: &Vector2<f64>,
    ) -> Result<(Vector2<f64>, Matrix2<f64>), ProjectionError> {
        let moved = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        let by_pixel = Matrix2::new(self.fx.recip(), 0.0, 0.0, self.fy.recip());
        let (point, by_moved) = self.lens.undistort(&moved).ok_or(ProjectionError::OutsideLens)?;
        Ok((point, by_moved * by_pixel))
    }

    fn to_pixels(&self, moved: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * moved.x + self.cx, self.fy * moved.y + self.cy)
    }
}

fn check_finite(coefficients: &[f64]) -> Result<(), CameraError> {
    match coefficients.iter().position(|k| !k.is_finite()) {
        Some(index) => Err(CameraError::DistortionValue { index }),
        None => Ok(()),
    }
}

/// The point of the plane z = 1 on the ray of a point in frame `camera`.
pub(crate) fn normalised(point_in_camera: &Vector3<f64>) -> Result<Vector2<f64>, ProjectionError> {
    let depth = point_in_camera.z;
    if depth > MIN_DEPTH_M {
        Ok(point_in_camera.xy() / depth)
    } else {
        Err(ProjectionError::BehindCamera { depth_m: depth })
    }
}

/// Derivative of `(x / z, y / z)` by the point.
pub(crate) fn normalised_by_point(point: &Vector3<f64>) -> Matrix2x3<f64> {
    let inverse = point.z.recip();
    let (x, y) = (point.x * inverse, point.y * inverse);
    Matrix2x3::new(inverse, 0.0, -x * inverse, 0.0, inverse, -y * inverse)
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "sides of small images")]

    use super::*;
    use crate::geometry::Affine;
    use proptest::prelude::*;

    fn pinhole() -> Camera {
        Camera::pinhole(612.0, 598.0, 319.5, 239.5).unwrap()
    }

    /// Lenses as calibrations find them, of every kind.
    pub(in crate::geometry::camera) fn any_camera() -> impl Strategy<Value = Camera> {
        let opencv = (
            prop::array::uniform4(-0.3..0.3f64),
            prop::array::uniform8(-0.01..0.01f64),
            prop::sample::select(vec![4, 5, 8, 12]),
        )
            .prop_map(|([k1, k2, k4, k5], [p1, p2, k3, k6, s1, s2, s3, s4], count)| {
                let [p1, p2] = [p1 / 5.0, p2 / 5.0];
                let all = [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4];
                pinhole().with_opencv_distortion(&all[..count]).unwrap()
            });
        let fisheye =
            prop::array::uniform4(-0.02..0.02f64).prop_map(|k| pinhole().with_fisheye_distortion(&k).unwrap());
        prop_oneof![Just(pinhole()), opencv, fisheye]
    }

    proptest! {
        /// A point seen by the camera of the resized image lies where the resize moves its pixel.
        #[test]
        fn a_resized_image_has_a_resized_camera(
            camera in any_camera(), x in -0.3..0.3f64, y in -0.3..0.3f64, scale in 0.2..3.0f64,
        ) {
            let camera = camera.with_size(640, 480).unwrap();
            let [width, height] = [640.0, 480.0].map(|side: f64| (side * scale).round());
            let (w, h) = (width as u32, height as u32);
            let resized = camera.for_resized(w, h).unwrap();
            let point = Vector3::new(x, y, 1.0);
            if let (Ok(before), Ok(after)) = (camera.project(&point), resized.project(&point)) {
                let to = Vector2::new(width, height);
                let moved = Affine::region_to_image(Vector2::zeros(), Vector2::new(640.0, 480.0), to).apply(&before);
                prop_assert!((moved - after).norm() < 1e-9);
            }
            prop_assert!(camera.for_resized(w, h + h / 50 + 2).is_err());
            prop_assert_eq!(camera.for_image(w, h).is_ok(), (w, h) == (640, 480));
        }

        #[test]
        fn unproject_undoes_project(camera in any_camera(), x in -0.9..0.9f64, y in -0.9..0.9f64, z in 0.1..5.0f64) {
            let point = Vector3::new(x * z, y * z, z);
            let Ok(pixel) = camera.project(&point) else {
                // Only a lens may refuse a point in front of the camera.
                prop_assert!(camera != pinhole());
                return Ok(());
            };
            let ray = camera.unproject(&pixel).unwrap();
            prop_assert!((camera.project(&ray.push(1.0)).unwrap() - pixel).norm() < 1e-8);
            prop_assert!((ray - Vector2::new(x, y)).norm() < 1e-7, "{ray}");
        }

        /// Whatever the pixel: the ray found projects there, or there is an error.
        #[test]
        fn unproject_never_invents(camera in any_camera(), x in -1e4..1e4f64, y in -1e4..1e4f64) {
            let pixel = Vector2::new(x, y);
            if let Ok(ray) = camera.unproject(&pixel) {
                prop_assert!((camera.project(&ray.push(1.0)).unwrap() - pixel).norm() < 1e-6);
            }
        }

        #[test]
        fn jacobians_agree_with_differences(camera in any_camera(), x in -0.5..0.5f64, y in -0.5..0.5f64, z in 0.3..3.0f64) {
            let point = Vector3::new(x * z, y * z, z);
            let pixel = camera.project(&point).unwrap();
            let (_, by_pixel) = camera.unproject_with_jacobian(&pixel).unwrap();
            let by_point = normalised_by_point(&point);
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-6);
                let numeric = (normalised(&(point + step)).unwrap() - normalised(&(point - step)).unwrap()) / 2e-6;
                prop_assert!((numeric - by_point.column(axis)).norm() < 1e-4 * by_point.norm());
            }
            for axis in 0..2 {
                let step = Vector2::ith(axis, 1e-3);
                let numeric = (camera.unproject(&(pixel + step)).unwrap() - camera.unproject(&(pixel - step)).unwrap()) / 2e-3;
                prop_assert!((numeric - by_pixel.column(axis)).norm() < 1e-4 * by_pixel.norm());
            }
        }
    }

    #[test]
    fn points_behind_the_camera_have_no_pixel() {
        let camera = pinhole();
        for depth_m in [-1.0, 0.0] {
            let behind = Err(ProjectionError::BehindCamera { depth_m });
            assert_eq!(camera.project(&Vector3::new(0.1, 0.1, depth_m)), behind);
        }
    }

    #[test]
    fn points_beyond_the_fold_of_a_lens_have_no_pixel() {
        // r (1 - 0.3 r²) grows up to r = 1.054, where it is 0.703.
        let camera = pinhole().with_opencv_distortion(&[-0.3, 0.0, 0.0, 0.0]).unwrap();
        assert!(camera.project(&Vector3::new(1.05, 0.0, 1.0)).is_ok());
        assert_eq!(camera.project(&Vector3::new(1.06, 0.0, 1.0)), Err(ProjectionError::OutsideLens));
        let pixel = |radius: f64| Vector2::new(319.5 + 612.0 * radius, 239.5);
        assert!(camera.unproject(&pixel(0.70)).is_ok());
        assert_eq!(camera.unproject(&pixel(0.71)), Err(ProjectionError::OutsideLens));
        assert_eq!(camera.unproject(&Vector2::new(f64::NAN, 0.0)), Err(ProjectionError::OutsideLens));
    }

    #[test]
    fn what_is_no_number_is_refused() {
        assert!(Camera::pinhole(f64::NAN, 1.0, 0.0, 0.0).is_err());
        assert_eq!(
            pinhole().with_fisheye_distortion(&[0.0, f64::NAN, 0.0, 0.0]),
            Err(CameraError::DistortionValue { index: 1 })
        );
    }
}
