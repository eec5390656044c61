//! Covariances of poses and of points.

use nalgebra::{Matrix2, Matrix3, Matrix6, Rotation3, SymmetricEigen, Vector3, Vector6};

use super::rotation::skew;

/// Covariance of a pose: translation (m²) before rotation (rad²), both along the axes of the parent frame.
pub type Covariance6 = Matrix6<f64>;

/// The same covariance along other axes, which a rotation leads to: `[[R, 0], [0, R]] Σ [[R, 0], [0, R]]ᵀ`.
#[must_use]
pub fn rotated_covariance(rotation: &Rotation3<f64>, covariance: &Covariance6) -> Covariance6 {
    let turn = block_diagonal(rotation.matrix());
    turn * covariance * turn.transpose()
}

/// Standard deviations over all axes: of the translation (metres) and of the rotation (radians).
#[must_use]
pub fn sigmas(covariance: &Covariance6) -> (f64, f64) {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().sqrt();
    (sigma(0), sigma(3))
}

/// Whether a matrix is finite, symmetric and without negative eigenvalues.
#[must_use]
pub fn is_covariance(matrix: &Covariance6) -> bool {
    let scale = matrix.amax();
    let symmetric = (matrix - matrix.transpose()).amax() <= 1e-9 * scale;
    if !(symmetric && matrix.diagonal().iter().all(|variance| *variance >= 0.0)) {
        return false;
    }
    // Translation and rotation have units of their own.
    let sigmas = matrix.diagonal().map(|variance| variance.sqrt().max(f64::MIN_POSITIVE));
    let correlations = Matrix6::from_fn(|row, column| matrix[(row, column)] / sigmas[row] / sigmas[column]);
    correlations.iter().all(|v| v.is_finite()) && SymmetricEigen::new(correlations).eigenvalues.min() > -1e-9
}

/// The covariance of a rigid body's step, seen at a point of it that lies `lever` further on (metres, parent's axes): a
/// turn moves that point too.
#[must_use]
pub fn covariance_about(covariance: &Covariance6, lever: &Vector3<f64>) -> Covariance6 {
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(lever));
    jacobian * covariance * jacobian.transpose()
}

/// What a covariance has beyond a part of it; nothing along directions in which the part is larger already. The whole where
/// the part has no inverse.
#[must_use]
pub fn excess(whole: &Covariance6, part: &Covariance6) -> Covariance6 {
    let Some(factor) = part.cholesky() else { return *whole };
    let root = factor.l();
    // Where the part is the unit matrix, directions compare whatever their units are.
    let solved = |matrix: &Covariance6| root.solve_lower_triangular(matrix);
    let whitened = solved(whole).and_then(|half| solved(&half.transpose()));
    let Some(whitened) = whitened else { return *whole };
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new((whitened + whitened.transpose()) * 0.5);
    let beyond = Matrix6::from_diagonal(&eigenvalues.map(|value| (value - 1.0).max(0.0)));
    let axes = root * eigenvectors;
    axes * beyond * axes.transpose()
}

/// `[[R, 0], [0, R]]`: turns the axes of a twist or a covariance.
pub(crate) fn block_diagonal(rotation: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation);
    matrix
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

/// `W` with `Wᵀ W = Σ⁻¹`, the inverse of the 2x2 Cholesky factor; `None` unless the matrix is positive definite.
pub(crate) fn whitening_of(covariance: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    let first = covariance.m11.sqrt();
    let across = covariance.m21 / first;
    let rest = covariance.m22 - across * across;
    // Not NaN either, and not singular but for rounding.
    if !(covariance.m11 > 0.0 && rest > 1e-12 * covariance.m22) {
        return None;
    }
    let second = rest.sqrt();
    Some(Matrix2::new(first.recip(), 0.0, -across / (first * second), second.recip()))
}
