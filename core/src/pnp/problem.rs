use nalgebra::{Matrix2, Vector2, Vector3};
use thiserror::Error;

use crate::geometry::{Camera, Pose, ProjectionError, normalised, whitening_of};

/// Fewest points that determine a pose and leave something to check it with.
pub const MIN_POINTS: usize = 4;
/// Most points: every triplet may be tried, and no heap is used.
pub const MAX_POINTS: usize = 16;

/// Input that no pose can be solved from.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PnpError {
    #[error("{given} points; perspective-n-point needs {MIN_POINTS} to {MAX_POINTS}")]
    PointCount { given: usize },
    #[error("{points} points, {pixels} pixels and {covariances} covariances; their counts must be equal")]
    Lengths { points: usize, pixels: usize, covariances: usize },
    #[error("point {index} has a value that is not finite")]
    NotFinite { index: usize },
    #[error("covariance of point {index} is not positive definite")]
    Covariance { index: usize },
    #[error("pixel of point {index}: {source}")]
    Pixel { index: usize, source: ProjectionError },
    #[error("the points lie on one line or in one place; they do not determine a pose")]
    Degenerate,
    #[error("no pose puts the points in front of the camera and near their pixels")]
    NoPose,
}

/// The usable points of one problem in normalised image coordinates (the plane z = 1), whitened by their covariances.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    len: usize,
    observations: [WhitenedPoint; MAX_POINTS],
}

/// One point and where it was seen.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WhitenedPoint {
    /// Its place among the points that were given.
    pub index: usize,
    pub point: Vector3<f64>,
    /// Unit direction of the camera ray.
    pub ray: Vector3<f64>,
    pub image: Vector2<f64>,
    /// `W` with `Wᵀ W = Σ⁻¹`, Σ in normalised coordinates.
    pub whitening: Matrix2<f64>,
    /// Trace of Σ.
    pub variance: f64,
}

impl Problem {
    /// `floor_px` is added to every covariance as an isotropic standard deviation. Points beyond the domain of the lens are
    /// left out, as long as there are enough others.
    pub(crate) fn new(
        points: &[Vector3<f64>],
        pixels: &[Vector2<f64>],
        covariances_px: &[Matrix2<f64>],
        camera: &Camera,
        floor_px: f64,
    ) -> Result<Self, PnpError> {
        if points.len() != pixels.len() || points.len() != covariances_px.len() {
            return Err(PnpError::Lengths {
                points: points.len(),
                pixels: pixels.len(),
                covariances: covariances_px.len(),
            });
        }
        if !(MIN_POINTS..=MAX_POINTS).contains(&points.len()) {
            return Err(PnpError::PointCount { given: points.len() });
        }
        let mut problem = Self { len: 0, observations: [WhitenedPoint::default(); MAX_POINTS] };
        let mut outside = None;
        for (index, ((point, pixel), covariance)) in points.iter().zip(pixels).zip(covariances_px).enumerate() {
            if !(point.iter().chain(pixel).chain(covariance).all(|v| v.is_finite())) {
                return Err(PnpError::NotFinite { index });
            }
            let floored = covariance + Matrix2::identity() * (floor_px * floor_px);
            whitening_of(&floored).ok_or(PnpError::Covariance { index })?;
            match WhitenedPoint::new(index, *point, pixel, &floored, camera) {
                Ok(seen) => {
                    problem.observations[problem.len] = seen;
                    problem.len += 1;
                }
                Err(source) => outside = outside.or(Some(PnpError::Pixel { index, source })),
            }
        }
        if let Some(error) = outside.filter(|_| problem.len < MIN_POINTS) {
            return Err(error);
        }
        if problem.points_are_on_a_line() {
            return Err(PnpError::Degenerate);
        }
        Ok(problem)
    }

    /// The same problem with every point moved by a rigid motion.
    pub(crate) fn moved(&self, motion: &Pose) -> Self {
        let mut moved = self.clone();
        for seen in &mut moved.observations[..moved.len] {
            seen.point = motion.transform(&seen.point);
        }
        moved
    }

    pub(crate) fn observations(&self) -> &[WhitenedPoint] {
        &self.observations[..self.len]
    }

    fn points_are_on_a_line(&self) -> bool {
        let origin = self.observations[0].point;
        let spans = || self.observations()[1..].iter().map(|seen| seen.point - origin);
        let longest = spans().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default();
        let length = longest.norm();
        length < 1e-9 || spans().all(|span| span.cross(&longest).norm() < 1e-6 * length * length)
    }
}

impl WhitenedPoint {
    /// An error beyond the domain of the lens, and so near to its end that the ray is known no more.
    fn new(
        index: usize,
        point: Vector3<f64>,
        pixel: &Vector2<f64>,
        covariance_px: &Matrix2<f64>,
        camera: &Camera,
    ) -> Result<Self, ProjectionError> {
        let (image, by_pixel) = camera.unproject_with_jacobian(pixel)?;
        let normalised = by_pixel * covariance_px * by_pixel.transpose();
        let whitening = whitening_of(&normalised).ok_or(ProjectionError::OutsideLens)?;
        Ok(Self { index, point, ray: image.push(1.0).normalize(), image, whitening, variance: normalised.trace() })
    }

    /// The whitened reprojection residual; `None` where the point is not in front of the camera.
    pub(crate) fn residual(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        normalised(point_in_camera).ok().map(|projected| self.whitening * (projected - self.image))
    }

    /// Squared Mahalanobis distance of the reprojection; infinite behind the camera.
    pub(crate) fn mahalanobis_squared(&self, pose: &Pose) -> f64 {
        self.residual(&pose.transform(&self.point)).map_or(f64::INFINITY, |residual| residual.norm_squared())
    }
}
