use nalgebra::Matrix2;

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
