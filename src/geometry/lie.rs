//! Exponential and logarithm of rotations and rigid transforms, and the adjoint.
//!
//! A twist is `(v, ω)`: translation part (m) before rotation part (rad), as in [`super::Covariance6`]. Formulas: Barfoot,
//! "State Estimation for Robotics", 2017, section 7.1; near angle zero their series, since they divide by the angle.

use nalgebra::{Matrix3, Matrix6, Rotation3, UnitQuaternion, Vector3, Vector6};

use super::Pose;
use super::pose::skew;

/// Below this angle the next term of each series is under the rounding error.
const SMALL_ANGLE: f64 = 1e-4;

/// Rotation vector (axis times angle, radians, at most pi long) of a rotation. Exact near zero and near a half turn,
/// where the angle from the trace loses its digits.
pub(super) fn rotation_log(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let quaternion = UnitQuaternion::from_rotation_matrix(rotation).into_inner();
    let sign = if quaternion.w < 0.0 { -1.0 } else { 1.0 };
    let (vector, w) = (quaternion.imag() * sign, quaternion.w * sign);
    let sine = vector.norm();
    if sine < SMALL_ANGLE {
        // atan(s / w) / s, with s = sine, to third order.
        return vector * (2.0 / w * (1.0 - sine * sine / (3.0 * w * w)));
    }
    vector * (2.0 * sine.atan2(w) / sine)
}

/// Left Jacobian of SO(3): `exp(ω)`'s translation is this times `v`.
fn left_jacobian(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle = omega.norm();
    let square = angle * angle;
    let (first, second) = if angle < SMALL_ANGLE {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
    };
    let cross = skew(omega);
    Matrix3::identity() + cross * first + cross * cross * second
}

fn left_jacobian_inverse(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle = omega.norm();
    let square = angle * angle;
    let second = if angle < SMALL_ANGLE {
        1.0 / 12.0 + square / 720.0
    } else {
        let half = 0.5 * angle;
        (1.0 - half * half.cos() / half.sin()) / square
    };
    let cross = skew(omega);
    Matrix3::identity() - cross * 0.5 + cross * cross * second
}

impl Pose {
    /// The rigid motion of a twist `(v, ω)`.
    #[must_use]
    pub fn exp(twist: &Vector6<f64>) -> Self {
        let (v, omega) = parts(twist);
        Self::new(Rotation3::new(omega), left_jacobian(&omega) * v)
    }

    /// The twist `(v, ω)` with the shortest `ω` whose [`Pose::exp`] is this pose.
    #[must_use]
    pub fn log(&self) -> Vector6<f64> {
        let omega = self.rotation_vector();
        join(&(left_jacobian_inverse(&omega) * self.translation()), &omega)
    }

    /// Moves twists from frame b to frame a: `a_from_b * exp(ξ) * b_from_a = exp(adjoint * ξ)`.
    #[must_use]
    pub fn adjoint(&self) -> Matrix6<f64> {
        let rotation = self.rotation().matrix();
        let mut matrix = block_diagonal(rotation);
        matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&(skew(self.translation()) * rotation));
        matrix
    }

    /// The small step (m, rad) that [`Pose::perturbed`] takes from this pose to another: the error that
    /// [`super::Covariance6`] describes.
    #[must_use]
    pub fn step_to(&self, other: &Self) -> Vector6<f64> {
        let turn = rotation_log(&(other.rotation() * self.rotation().inverse()));
        join(&(other.translation() - self.translation()), &turn)
    }
}

/// `[[R, 0], [0, R]]`: turns the axes of a twist or a covariance.
pub(crate) fn block_diagonal(rotation: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation);
    matrix
}

/// Standard deviations over all axes: of the translation (metres) and of the rotation (radians).
pub(crate) fn sigmas(covariance: &Matrix6<f64>) -> (f64, f64) {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().sqrt();
    (sigma(0), sigma(3))
}

/// The covariance of a rigid body's step, seen at a point of it that lies `lever` further on (metres, parent's axes): a
/// turn moves that point too.
pub(crate) fn covariance_about(covariance: &Matrix6<f64>, lever: &Vector3<f64>) -> Matrix6<f64> {
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(lever));
    jacobian * covariance * jacobian.transpose()
}

/// The translation and the rotation part of a twist or a step.
pub(crate) fn parts(twist: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (twist.fixed_rows::<3>(0).into(), twist.fixed_rows::<3>(3).into())
}

/// A twist or a step of its translation and its rotation part.
pub(crate) fn join(translation: &Vector3<f64>, rotation: &Vector3<f64>) -> Vector6<f64> {
    let mut twist = Vector6::zeros();
    twist.fixed_rows_mut::<3>(0).copy_from(translation);
    twist.fixed_rows_mut::<3>(3).copy_from(rotation);
    twist
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::tests::any_pose;
    use proptest::prelude::*;

    /// Twists with angles from nothing to almost a half turn, each size as likely as the next.
    fn any_twist() -> impl Strategy<Value = Vector6<f64>> {
        let angle = prop_oneof![(-12.0..0.4971f64).prop_map(|p| 10f64.powf(p)), Just(0.0), -1e-3..-1e-6f64]
            .prop_map(|a| if a < 0.0 { std::f64::consts::PI + a } else { a });
        let direction =
            prop::array::uniform3(-1.0..1.0f64).prop_filter("a direction", |d| Vector3::from(*d).norm() > 0.1);
        (prop::array::uniform3(-5.0..5.0f64), direction, angle)
            .prop_map(|(v, axis, angle)| join(&v.into(), &(Vector3::from(axis).normalize() * angle)))
    }

    proptest! {
        #[test]
        fn log_undoes_exp(twist in any_twist()) {
            let back = Pose::exp(&twist).log();
            prop_assert!((back - twist).norm() < 1e-9, "{twist} {back}");
        }

        #[test]
        fn exp_undoes_log(pose in any_pose()) {
            prop_assert!((Pose::exp(&pose.log()).matrix() - pose.matrix()).norm() < 1e-9);
        }

        #[test]
        fn half_of_a_motion_twice_is_the_motion(twist in any_twist()) {
            let half = Pose::exp(&(twist / 2.0));
            prop_assert!(((half * half).matrix() - Pose::exp(&twist).matrix()).norm() < 1e-9);
        }

        #[test]
        fn adjoint_moves_twists_between_frames(pose in any_pose(), twist in any_twist()) {
            let moved = pose * Pose::exp(&twist) * pose.inverse();
            prop_assert!((moved.matrix() - Pose::exp(&(pose.adjoint() * twist)).matrix()).norm() < 1e-8);
        }

        #[test]
        fn step_to_undoes_perturbed(pose in any_pose(), step in any_twist()) {
            let (translation, rotation) = parts(&step);
            let back = pose.step_to(&pose.perturbed(&translation, &rotation));
            prop_assert!((back - step).norm() < 1e-8);
        }
    }
}
