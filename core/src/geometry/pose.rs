use nalgebra::{Matrix3, Matrix4, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector6};
use thiserror::Error;

use super::covariance::join;
use super::rotation::{nearest_rotation, renormalised, rotation_log};

/// A rigid transform `a_from_b`, an element of SE(3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    rotation: Rotation3<f64>,
    translation: Vector3<f64>,
}

/// Numbers that are not a rigid transform.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PoseError {
    #[error("pose has a value that is not finite")]
    NotFinite,
    #[error("quaternion xyzw has norm {norm:.6}; a rotation needs norm 1")]
    NotUnit { norm: f64 },
    #[error("3x3 block is not a rotation: it deviates from one by {deviation:.1e} (tolerance 1e-3)")]
    NotRotation { deviation: f64 },
    #[error("translation of {metres} m; it must be below {MAX_TRANSLATION_M} m")]
    TooFar { metres: f64 },
    #[error("last row of a 4x4 transform must be 0 0 0 1")]
    LastRow,
}

/// Numbers printed with a few digits are accepted and projected onto the nearest rotation.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Farther than this nothing is seen, and the squares of such numbers are no numbers.
const MAX_TRANSLATION_M: f64 = 1e9;

fn check_numbers(rotation: &[f64], translation_m: &[f64; 3]) -> Result<(), PoseError> {
    if !rotation.iter().chain(translation_m).all(|v| v.is_finite()) {
        return Err(PoseError::NotFinite);
    }
    match translation_m.iter().find(|v| v.abs() > MAX_TRANSLATION_M) {
        Some(metres) => Err(PoseError::TooFar { metres: *metres }),
        None => Ok(()),
    }
}

impl Pose {
    /// A pose from parts that are already a rotation and a translation in metres.
    #[must_use]
    pub fn new(rotation: Rotation3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// The frame in itself.
    #[must_use]
    pub fn identity() -> Self {
        Self::new(Rotation3::identity(), Vector3::zeros())
    }

    /// From a quaternion `xyzw` and a translation in metres.
    ///
    /// # Errors
    /// When a value is not finite or the quaternion's norm is not 1 within 1e-3.
    pub fn from_quaternion_xyzw(xyzw: [f64; 4], translation_m: [f64; 3]) -> Result<Self, PoseError> {
        check_numbers(&xyzw, &translation_m)?;
        let quaternion = Quaternion::new(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
        let norm = quaternion.norm();
        if (norm - 1.0).abs() > ROTATION_TOLERANCE {
            return Err(PoseError::NotUnit { norm });
        }
        let rotation = UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
        Ok(Self::new(rotation, translation_m.into()))
    }

    /// From a 3x3 matrix (row-major) that should be a rotation, and a translation in metres.
    ///
    /// # Errors
    /// When a value is not finite, or the matrix deviates from a rotation by more than 1e-3.
    pub fn from_row_major(rotation: [f64; 9], translation_m: [f64; 3]) -> Result<Self, PoseError> {
        check_numbers(&rotation, &translation_m)?;
        let matrix = Matrix3::from_row_slice(&rotation);
        let nearest = nearest_rotation(&matrix);
        let deviation = (nearest.matrix() - matrix).norm();
        if deviation > ROTATION_TOLERANCE {
            return Err(PoseError::NotRotation { deviation });
        }
        Ok(Self::new(nearest, translation_m.into()))
    }

    /// From a homogeneous 4x4 matrix, translation in metres.
    ///
    /// # Errors
    /// As [`Pose::from_row_major`], and when the last row is not `0 0 0 1`.
    pub fn from_matrix(matrix: &Matrix4<f64>) -> Result<Self, PoseError> {
        if matrix.row(3) != Matrix4::identity().row(3) {
            return Err(PoseError::LastRow);
        }
        let rotation = [0, 1, 2, 3, 4, 5, 6, 7, 8].map(|k| matrix[(k / 3, k % 3)]);
        Self::from_row_major(rotation, [matrix.m14, matrix.m24, matrix.m34])
    }

    /// The same pose in a world that is so many times as large.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self::new(self.rotation, self.translation * factor)
    }

    /// Rotation of frame b in frame a.
    #[must_use]
    pub fn rotation(&self) -> &Rotation3<f64> {
        &self.rotation
    }

    /// Origin of frame b in frame a, metres.
    #[must_use]
    pub fn translation(&self) -> &Vector3<f64> {
        &self.translation
    }

    /// The unit quaternion `xyzw` with `w >= 0`.
    #[must_use]
    pub fn rotation_xyzw(&self) -> [f64; 4] {
        let q = UnitQuaternion::from_rotation_matrix(&self.rotation).into_inner();
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [q.i * sign, q.j * sign, q.k * sign, q.w * sign]
    }

    /// [`Pose::translation`] as numbers.
    #[must_use]
    pub fn translation_m(&self) -> [f64; 3] {
        self.translation.into()
    }

    /// The homogeneous 4x4 matrix.
    #[must_use]
    pub fn matrix(&self) -> Matrix4<f64> {
        let mut matrix = self.rotation.to_homogeneous();
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        matrix
    }

    /// `b_from_a` of `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(rotation, -(rotation * self.translation))
    }

    /// `point_in_a` of `point_in_b`.
    #[must_use]
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Moves the pose by a small translation (m) and a rotation vector (rad) about the parent frame's fixed axes: the
    /// perturbation that [`super::Covariance6`] describes.
    #[must_use]
    pub fn perturbed(&self, translation: &Vector3<f64>, rotation: &Vector3<f64>) -> Self {
        let moved = Rotation3::new(*rotation) * self.rotation;
        // Products of rotations drift from orthonormality by rounding; one Newton step per call holds it.
        Self::new(renormalised(&moved), self.translation + translation)
    }

    /// The same pose with the rotation that a matrix from a closed form is meant to be: Newton's iteration for the polar
    /// decomposition, which converges from well beyond any rounding error.
    pub(crate) fn orthonormalised(&self) -> Self {
        let rotation = (0..4).fold(self.rotation, |rotation, _| renormalised(&rotation));
        Self::new(rotation, self.translation)
    }

    /// The small step (m, rad) that [`Pose::perturbed`] takes from this pose to another: the error that
    /// [`super::Covariance6`] describes.
    #[must_use]
    pub fn step_to(&self, other: &Self) -> Vector6<f64> {
        let turn = rotation_log(&(other.rotation() * self.rotation().inverse()));
        join(&(other.translation() - self.translation()), &turn)
    }

    /// Angle in radians, 0 to pi, of the rotation between two poses.
    #[must_use]
    pub fn angle_to(&self, other: &Self) -> f64 {
        // From the chord, since the arc cosine of the trace is inexact near zero, and NaN where rounding passes 1.
        let chord = (self.rotation.matrix() - other.rotation.matrix()).norm() / 8.0_f64.sqrt();
        2.0 * chord.min(1.0).asin()
    }
}

impl std::ops::Mul for Pose {
    type Output = Self;

    /// `a_from_c = a_from_b * b_from_c`.
    fn mul(self, other: Self) -> Self {
        Self::new(self.rotation * other.rotation, self.transform(&other.translation))
    }
}

#[cfg(test)]
pub(in crate::geometry) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(in crate::geometry) fn any_pose() -> impl Strategy<Value = Pose> {
        (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-5.0..5.0f64))
            .prop_map(|(r, t)| Pose::new(Rotation3::new(Vector3::from(r)), Vector3::from(t)))
    }

    /// From nothing to almost a half turn, each size as likely as the next.
    fn any_angle() -> impl Strategy<Value = f64> {
        let small = (-12.0..0.4971f64).prop_map(|power| 10f64.powf(power));
        prop_oneof![small, Just(0.0), (1e-6..1e-3f64).prop_map(|less| std::f64::consts::PI - less)]
    }

    fn close(a: &Pose, b: &Pose) -> bool {
        (a.matrix() - b.matrix()).norm() < 1e-9
    }

    proptest! {
        #[test]
        fn inverse_undoes(pose in any_pose()) {
            prop_assert!(close(&(pose * pose.inverse()), &Pose::identity()));
        }

        #[test]
        fn composition_is_application_in_turn(a in any_pose(), b in any_pose(), p in prop::array::uniform3(-2.0..2.0f64)) {
            let point = Vector3::from(p);
            let apart = (a * b).transform(&point) - a.transform(&b.transform(&point));
            prop_assert!(apart.norm() < 1e-9);
        }

        #[test]
        fn quaternion_round_trip(pose in any_pose()) {
            let xyzw = pose.rotation_xyzw();
            prop_assert!(xyzw[3] >= 0.0);
            let back = Pose::from_quaternion_xyzw(xyzw, pose.translation_m()).unwrap();
            prop_assert!(close(&pose, &back));
        }

        #[test]
        fn matrix_round_trip(pose in any_pose()) {
            prop_assert!(close(&Pose::from_matrix(&pose.matrix()).unwrap(), &pose));
        }

        #[test]
        fn step_to_undoes_perturbed(
            pose in any_pose(), shift in prop::array::uniform3(-5.0..5.0f64), axis in prop::array::uniform3(-1.0..1.0f64),
            angle in any_angle(),
        ) {
            prop_assume!(Vector3::from(axis).norm() > 0.1);
            let step = join(&shift.into(), &(Vector3::from(axis).normalize() * angle));
            let back = pose.step_to(&pose.perturbed(&shift.into(), &step.fixed_rows::<3>(3).into_owned()));
            prop_assert!((back - step).norm() < 1e-8);
        }

        #[test]
        fn angle_is_that_of_the_rotation_between(pose in any_pose(), axis in prop::array::uniform3(-1.0..1.0f64), angle in 0.0..3.1f64) {
            prop_assume!(Vector3::from(axis).norm() > 0.1);
            let turned = pose.perturbed(&Vector3::zeros(), &(Vector3::from(axis).normalize() * angle));
            prop_assert!((pose.angle_to(&turned) - angle).abs() < 1e-7);
            prop_assert!(pose.angle_to(&pose) < 1e-15);
        }

        #[test]
        fn perturbation_keeps_the_rotation_orthonormal(pose in any_pose(), r in prop::array::uniform3(-0.5..0.5f64)) {
            let mut moved = pose;
            for _ in 0..1000 {
                moved = moved.perturbed(&Vector3::zeros(), &Vector3::from(r));
            }
            let gram = moved.rotation().matrix().transpose() * moved.rotation().matrix();
            prop_assert!((gram - Matrix3::identity()).norm() < 1e-12);
        }
    }

    #[test]
    fn refuses_what_is_no_rotation() {
        let reflection = [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        assert!(matches!(Pose::from_row_major(reflection, [0.0; 3]), Err(PoseError::NotRotation { .. })));
        assert!(matches!(Pose::from_row_major([f64::NAN; 9], [0.0; 3]), Err(PoseError::NotFinite)));
        assert!(matches!(Pose::from_row_major([0.0; 9], [0.0; 3]), Err(PoseError::NotRotation { .. })));
        assert_eq!(Pose::from_matrix(&(Matrix4::identity() * 2.0)), Err(PoseError::LastRow));
        assert!(matches!(Pose::from_quaternion_xyzw([0.0; 4], [0.0; 3]), Err(PoseError::NotUnit { .. })));
    }
}
