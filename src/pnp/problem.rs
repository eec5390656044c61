use nalgebra::{Matrix2, Vector2, Vector3};
use thiserror::Error;

use crate::geometry::{Camera, Pose};

/// Fewest points that determine a pose and leave something to check it with.
pub const MIN_POINTS: usize = 4;
/// Most points: every triplet is tried, and no heap is used.
pub const MAX_POINTS: usize = 16;

/// Input that no pose can be solved from.
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
    #[error("the points lie on one line or in one place; no pose follows from them")]
    Degenerate,
    #[error("no pose puts the points in front of the camera and near their pixels")]
    NoPose,
}

/// The points of one problem in normalised image coordinates (the plane z = 1), whitened by their covariances.
#[derive(Clone, Debug)]
pub(super) struct Problem {
    len: usize,
    points: [Vector3<f64>; MAX_POINTS],
    rays: [Vector3<f64>; MAX_POINTS],
    image: [Vector2<f64>; MAX_POINTS],
    /// `W` with `Wᵀ W = Σ⁻¹`, Σ in normalised coordinates.
    whitening: [Matrix2<f64>; MAX_POINTS],
}

impl Problem {
    /// `floor_px` is added to every covariance as an isotropic standard deviation.
    pub(super) fn new(
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
        let mut problem = Self {
            len: points.len(),
            points: [Vector3::zeros(); MAX_POINTS],
            rays: [Vector3::zeros(); MAX_POINTS],
            image: [Vector2::zeros(); MAX_POINTS],
            whitening: [Matrix2::zeros(); MAX_POINTS],
        };
        let normalised_from_pixels = Matrix2::from_diagonal(&camera.focal().map(f64::recip));
        for (index, ((point, pixel), covariance)) in points.iter().zip(pixels).zip(covariances_px).enumerate() {
            if !(point.iter().chain(pixel).chain(covariance).all(|v| v.is_finite())) {
                return Err(PnpError::NotFinite { index });
            }
            let floored = covariance + Matrix2::identity() * (floor_px * floor_px);
            let normalised = normalised_from_pixels * floored * normalised_from_pixels;
            let whitening = normalised
                .cholesky()
                .and_then(|factor| factor.l().try_inverse())
                .ok_or(PnpError::Covariance { index })?;
            let image = camera.unproject(pixel);
            problem.points[index] = *point;
            problem.image[index] = image;
            problem.rays[index] = Vector3::new(image.x, image.y, 1.0).normalize();
            problem.whitening[index] = whitening;
        }
        if problem.points_are_on_a_line() {
            return Err(PnpError::Degenerate);
        }
        Ok(problem)
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn point(&self, index: usize) -> &Vector3<f64> {
        &self.points[index]
    }

    /// Unit direction of the camera ray through an image point.
    pub(super) fn ray(&self, index: usize) -> &Vector3<f64> {
        &self.rays[index]
    }

    pub(super) fn whitening(&self, index: usize) -> &Matrix2<f64> {
        &self.whitening[index]
    }

    /// The whitened reprojection residual; `None` where the point is not in front of the camera.
    pub(super) fn residual(&self, index: usize, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        let depth = point_in_camera.z;
        (depth > 1e-9).then(|| {
            let projected = Vector2::new(point_in_camera.x / depth, point_in_camera.y / depth);
            self.whitening[index] * (projected - self.image[index])
        })
    }

    /// Squared Mahalanobis distance of a point's reprojection; infinite behind the camera.
    pub(super) fn mahalanobis_squared(&self, index: usize, pose: &Pose) -> f64 {
        self.residual(index, &pose.transform(&self.points[index]))
            .map_or(f64::INFINITY, |residual| residual.norm_squared())
    }

    fn points_are_on_a_line(&self) -> bool {
        let origin = self.points[0];
        let spans = || self.points[1..self.len].iter().map(|p| p - origin);
        let longest = spans().max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap_or_default();
        let length = longest.norm();
        length < 1e-9 || spans().all(|span| span.cross(&longest).norm() < 1e-6 * length * length)
    }
}
