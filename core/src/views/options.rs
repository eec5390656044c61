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
    /// What misfits are divided by where poses are weighed against each other, or against leaving a view out. 1 where the errors
    /// of a view's points are independent; more where they are alike, since then many points say little more than one. It
    /// changes which pose and which views are chosen, not how large the covariance is: that is for
    /// [`Mode::shared`](super::Mode::shared).
    pub tempering: f64,
}

impl Default for ViewsOptions {
    fn default() -> Self {
        let camera_covariance = isotropic_covariance(1e-3, 0.1_f64.to_radians());
        Self { floor_px: 0.3, camera_covariance, tempering: 1.0 }
    }
}
