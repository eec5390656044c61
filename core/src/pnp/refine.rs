//! Levenberg-Marquardt on a pose, with a loss that says how much a point counts.
//!
//! Steps are a translation and a rotation vector along the camera's axes, see [`Pose::perturbed`].

use nalgebra::{Matrix2x3, Matrix3, Matrix6, Vector2, Vector3, Vector6};

use super::problem::{MAX_POINTS, Problem, WhitenedPoint};
use crate::geometry::{Pose, join, normalised_by_point, parts};

const MAX_DAMPING: f64 = 1e6;

/// When to stop.
#[derive(Clone, Copy)]
pub(super) struct Effort {
    pub max_steps: usize,
    /// Length of the last step, in standard deviations of the pose squared (Newton's decrement).
    pub tolerance: f64,
}

/// What squared Mahalanobis distances cost.
pub(crate) trait Loss {
    fn cost(&self, squares: &[f64]) -> f64;
    /// The derivative of the cost by one of them.
    fn weight(&self, squared: f64) -> f64;
}

/// Grows with the logarithm of a gross error: every point keeps some pull, so that a start far off finds its way.
pub(crate) struct Cauchy {
    /// In standard deviations.
    pub width: f64,
}

impl Loss for Cauchy {
    fn cost(&self, squares: &[f64]) -> f64 {
        let width = self.width * self.width;
        // One logarithm for four points; their product stays far from overflow.
        let product = |four: &[f64]| four.iter().map(|squared| 1.0 + squared / width).product::<f64>();
        width * squares.chunks(4).map(|four| product(four).ln()).sum::<f64>()
    }

    fn weight(&self, squared: f64) -> f64 {
        (1.0 + squared / (self.width * self.width)).recip()
    }
}

/// Least squares over the points within a limit (MSAC): the estimate whose covariance is the inverse Hessian.
pub(crate) struct Truncated {
    /// Squared Mahalanobis distance.
    pub limit: f64,
}

impl Loss for Truncated {
    fn cost(&self, squares: &[f64]) -> f64 {
        squares.iter().map(|squared| squared.min(self.limit)).sum()
    }

    fn weight(&self, squared: f64) -> f64 {
        f64::from(u8::from(squared < self.limit))
    }
}

/// A pose with its cost and the normal equations there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refined {
    pub pose: Pose,
    pub cost: f64,
    /// Gauss-Newton Hessian over the points, each as often as its weight says.
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
}

impl Refined {
    /// `None` when a point is behind the camera.
    pub(crate) fn at(problem: &Problem, pose: Pose, loss: &impl Loss) -> Option<Self> {
        let rotation = pose.rotation().matrix();
        let mut squares = [0.0; MAX_POINTS];
        let mut blocks = [Matrix3::zeros(); 3];
        let mut gradient = [Vector3::zeros(); 2];
        for (seen, squared) in problem.observations().iter().zip(&mut squares) {
            let rotated = rotation * seen.point;
            let (residual, by_point) = residual_and_jacobian(seen, &(rotated + pose.translation()))?;
            *squared = residual.norm_squared();
            let weight = loss.weight(*squared);
            if weight > 0.0 {
                // `-b [r]x` of a row b is `r x b`.
                let cross = |row: usize| rotated.cross(&by_point.row(row).transpose()).transpose();
                let by_turn = Matrix2x3::from_rows(&[cross(0), cross(1)]);
                let weighted = by_point.transpose() * weight;
                blocks[0] += weighted * by_point;
                blocks[1] += weighted * by_turn;
                blocks[2] += by_turn.transpose() * weight * by_turn;
                gradient[0] += weighted * residual;
                gradient[1] += by_turn.transpose() * (residual * weight);
            }
        }
        let mut hessian = Matrix6::zeros();
        hessian.fixed_view_mut::<3, 3>(0, 0).copy_from(&blocks[0]);
        hessian.fixed_view_mut::<3, 3>(0, 3).copy_from(&blocks[1]);
        hessian.fixed_view_mut::<3, 3>(3, 0).copy_from(&blocks[1].transpose());
        hessian.fixed_view_mut::<3, 3>(3, 3).copy_from(&blocks[2]);
        let cost = loss.cost(&squares[..problem.observations().len()]);
        Some(Self { pose, cost, hessian, gradient: join(&gradient[0], &gradient[1]) })
    }
}

/// Lowers the cost of a pose. Every accepted step keeps all points in front of the camera. `None` when the start does
/// not.
pub(super) fn refine(problem: &Problem, start: Pose, loss: &impl Loss, effort: Effort) -> Option<Refined> {
    let mut best = Refined::at(problem, start.orthonormalised(), loss)?;
    let mut damping = 1e-6;
    for _ in 0..effort.max_steps {
        let mut decrement = 0.0;
        let lower = loop {
            let damped = best.hessian + Matrix6::from_diagonal(&(best.hessian.diagonal() * damping));
            let step = damped.cholesky().map(|factor| -factor.solve(&best.gradient));
            let lower = step.and_then(|step| {
                decrement = -step.dot(&best.gradient);
                let (translation, rotation) = parts(&step);
                let moved = Refined::at(problem, best.pose.perturbed(&translation, &rotation), loss)?;
                (moved.cost <= best.cost).then_some(moved)
            });
            if lower.is_some() || damping > MAX_DAMPING || decrement < effort.tolerance {
                break lower;
            }
            damping = (damping * 30.0).max(1e-3);
        };
        let Some(lower) = lower else { break };
        best = lower;
        damping *= 0.1;
        if decrement < effort.tolerance {
            break;
        }
    }
    Some(best)
}

/// The whitened residual of a point in frame `camera`, and its derivative by the point.
fn residual_and_jacobian(
    seen: &WhitenedPoint,
    point_in_camera: &Vector3<f64>,
) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    let residual = seen.residual(point_in_camera)?;
    Some((residual, seen.whitening * normalised_by_point(point_in_camera)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use nalgebra::{Matrix2, Rotation3};
    use proptest::prelude::*;

    proptest! {
        /// The gradient is that of the cost, for both losses: half of it, since costs are squares.
        #[test]
        fn gradient_agrees_with_differences(
            rotation in prop::array::uniform3(-3.0..3.0f64),
            offset in prop::array::uniform2(-0.2..0.2f64),
            noise in prop::array::uniform2(-5.0..5.0f64),
        ) {
            let camera = Camera::pinhole(600.0, 580.0, 320.0, 240.0).unwrap();
            let pose = Pose::new(Rotation3::new(rotation.into()), Vector3::new(offset[0], offset[1], 0.7));
            let points = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [-0.1, 0.02, 0.03]].map(Vector3::from);
            let pixels = points.map(|p| camera.project(&pose.transform(&p)).unwrap() + Vector2::from(noise));
            let covariances = [Matrix2::new(2.0, 0.7, 0.7, 1.0); 4];
            let problem = Problem::new(&points, &pixels, &covariances, &camera, 0.0).unwrap();
            check(&problem, pose, &Cauchy { width: 2.0 })?;
            check(&problem, pose, &Truncated { limit: 1e9 })?;
        }
    }

    fn check(problem: &Problem, pose: Pose, loss: &impl Loss) -> Result<(), TestCaseError> {
        let at = Refined::at(problem, pose, loss).unwrap();
        for axis in 0..6 {
            let cost = |size: f64| {
                let (translation, rotation) = parts(&(Vector6::ith(axis, size)));
                Refined::at(problem, pose.perturbed(&translation, &rotation), loss).unwrap().cost
            };
            let numeric = (cost(1e-6) - cost(-1e-6)) / 4e-6;
            prop_assert!(
                (numeric - at.gradient[axis]).abs() < 1e-4 * (1.0 + at.gradient.norm()),
                "{axis} {numeric} {}",
                at.gradient
            );
        }
        Ok(())
    }
}
