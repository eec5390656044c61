use super::view::isotropic_covariance;
use crate::geometry::Covariance6;

/// What is known beforehand.
#[derive(Clone, Debug)]
pub struct ViewsOptions {
    /// Standard deviation added to every point, pixels: as [`crate::pnp::Options::floor_px`].
    pub floor_px: f64,
    /// Covariance of camera poses that state none: 1 mm and 0.1 degrees along each axis, as robots that were calibrated with
    /// care have it.
    pub camera_covariance: Covariance6,
    /// Covariance of the step by which one view may see the pose off for what its points have in common, in covariances of its
    /// own pose ([`Mode::covariance`](super::Mode::covariance)). 0 where the errors of its points are independent; `f² - 1` where its own covariance is
    /// known to be too small by a factor of `f` along each axis.
    pub shared_error: f64,
}

impl Default for ViewsOptions {
    fn default() -> Self {
        let camera_covariance = isotropic_covariance(1e-3, 0.1_f64.to_radians());
        Self { floor_px: 0.3, camera_covariance, shared_error: 0.0 }
    }
}
