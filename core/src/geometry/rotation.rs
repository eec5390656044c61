//! Rotations as such: logarithm, nearest rotation, cross products.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Below this angle the next term of the series is under the rounding error.
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

/// The matrix of the cross product: `skew(a) * b = a x b`.
#[must_use]
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The rotation nearest to a matrix in the Frobenius norm.
pub(super) fn nearest_rotation(matrix: &Matrix3<f64>) -> Rotation3<f64> {
    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Rotation3::identity();
    };
    let sign = (u * v_t).determinant().signum();
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// One Newton step towards the nearest orthonormal matrix.
pub(super) fn renormalised(rotation: &Rotation3<f64>) -> Rotation3<f64> {
    let r = rotation.matrix();
    Rotation3::from_matrix_unchecked(r * (Matrix3::identity() * 1.5 - r.transpose() * r * 0.5))
}
