//! Robust Levenberg-Marquardt on SE(3).

use nalgebra::{Matrix2x3, Matrix2x6, Matrix6, Vector2, Vector6};

use super::problem::Problem;
use crate::geometry::{Pose, skew};

const MAX_ITERATIONS: usize = 15;
/// Width of the Cauchy loss in standard deviations.
const CAUCHY_WIDTH: f64 = 2.0;
/// Steps shorter than this (in standard deviations of the pose, roughly) end the iteration.
const MIN_COST_CHANGE: f64 = 1e-6;

/// A refined pose with its robust cost.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refined {
    pub pose: Pose,
    pub cost: f64,
}

/// Lowers the Cauchy cost of a pose. Every accepted step keeps all points in front of the camera.
///
/// The step is a translation and a rotation vector along the camera's axes, see [`Pose::perturbed`].
pub(super) fn refine(problem: &Problem, start: &Pose) -> Option<Refined> {
    let mut pose = *start;
    let mut cost = robust_cost(problem, &pose)?;
    let mut damping = 1e-3;
    for _ in 0..MAX_ITERATIONS {
        let (hessian, gradient) =
            normal_equations(problem, &pose, |squared| 1.0 / (1.0 + squared / (CAUCHY_WIDTH * CAUCHY_WIDTH)))?;
        let mut improved = false;
        while damping < 1e8 {
            let damped = hessian + Matrix6::from_diagonal(&(hessian.diagonal() * damping));
            let step = damped.cholesky().map(|factor| -factor.solve(&gradient));
            let candidate = step.map(|s: Vector6<f64>| {
                pose.perturbed(&s.fixed_rows::<3>(0).into_owned(), &s.fixed_rows::<3>(3).into_owned())
            });
            if let Some((candidate, lower)) =
                candidate.and_then(|c| robust_cost(problem, &c).filter(|new| *new < cost).map(|new| (c, new)))
            {
                improved = cost - lower > MIN_COST_CHANGE;
                (pose, cost) = (candidate, lower);
                damping = (damping * 0.1).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if !improved {
            break;
        }
    }
    Some(Refined { pose, cost })
}

/// The Gauss-Newton Hessian over the points for which `weight` (of the squared Mahalanobis distance) is not zero, and
/// the gradient.
pub(super) fn normal_equations(
    problem: &Problem,
    pose: &Pose,
    weight: impl Fn(f64) -> f64,
) -> Option<(Matrix6<f64>, Vector6<f64>)> {
    let mut hessian = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    for index in 0..problem.len() {
        let (residual, jacobian) = residual_and_jacobian(problem, index, pose)?;
        let weight = weight(residual.norm_squared());
        hessian += jacobian.transpose() * jacobian * weight;
        gradient += jacobian.transpose() * residual * weight;
    }
    Some((hessian, gradient))
}

/// The whitened residual of a point and its derivative by the step (translation, rotation).
fn residual_and_jacobian(problem: &Problem, index: usize, pose: &Pose) -> Option<(Vector2<f64>, Matrix2x6<f64>)> {
    let rotated = pose.rotation() * problem.point(index);
    let in_camera = rotated + pose.translation();
    let residual = problem.residual(index, &in_camera)?;
    let inverse_depth = in_camera.z.recip();
    let projection = Matrix2x3::new(
        inverse_depth,
        0.0,
        -in_camera.x * inverse_depth * inverse_depth,
        0.0,
        inverse_depth,
        -in_camera.y * inverse_depth * inverse_depth,
    );
    let by_point = problem.whitening(index) * projection;
    let mut jacobian = Matrix2x6::zeros();
    jacobian.fixed_columns_mut::<3>(0).copy_from(&by_point);
    jacobian.fixed_columns_mut::<3>(3).copy_from(&(-by_point * skew(&rotated)));
    Some((residual, jacobian))
}

/// Sum of Cauchy losses; `None` when a point is behind the camera.
fn robust_cost(problem: &Problem, pose: &Pose) -> Option<f64> {
    let width = CAUCHY_WIDTH * CAUCHY_WIDTH;
    let mut cost = 0.0;
    for index in 0..problem.len() {
        let squared = problem.mahalanobis_squared(index, pose);
        if !squared.is_finite() {
            return None;
        }
        cost += width * (squared / width).ln_1p();
    }
    Some(cost)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use nalgebra::{Matrix2, Rotation3, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobian_agrees_with_differences(
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
            for index in 0..4 {
                let (residual, jacobian) = residual_and_jacobian(&problem, index, &pose).unwrap();
                for axis in 0..6 {
                    let mut step = Vector6::zeros();
                    step[axis] = 1e-6;
                    let moved = pose.perturbed(&step.fixed_rows::<3>(0).into(), &step.fixed_rows::<3>(3).into());
                    let after = problem.residual(index, &moved.transform(problem.point(index))).unwrap();
                    let numeric = (after - residual) / 1e-6;
                    let apart = (numeric - jacobian.column(axis)).norm();
                    prop_assert!(apart < 1e-3 * (1.0 + numeric.norm()), "{numeric} {}", jacobian.column(axis));
                }
            }
        }
    }
}
