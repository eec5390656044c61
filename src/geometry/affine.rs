use nalgebra::{Matrix2, Vector2};

/// A 2D map `to = scale * from + offset` with one scale for each axis: what crops and letterboxes do to pixels.
///
/// Both sides have pixel centres at integers, so a plain resize by `s` is `scale = s`, `offset = (s - 1) / 2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisAlignedAffine {
    scale: Vector2<f64>,
    offset: Vector2<f64>,
}

impl AxisAlignedAffine {
    /// The map that takes the region with this top left corner and size (in pixel-EDGE coordinates: the image
    /// spans 0 to its width) to an image of `to` pixels.
    #[must_use]
    pub fn region_to_image(top_left: Vector2<f64>, size: Vector2<f64>, to: Vector2<f64>) -> Self {
        let scale = to.component_div(&size);
        let half = Vector2::repeat(0.5);
        Self { scale, offset: (half - top_left).component_mul(&scale) - half }
    }

    #[must_use]
    pub fn apply(&self, point: &Vector2<f64>) -> Vector2<f64> {
        point.component_mul(&self.scale) + self.offset
    }

    #[must_use]
    pub fn inverse(&self) -> Self {
        let scale = self.scale.map(f64::recip);
        Self { scale, offset: -self.offset.component_mul(&scale) }
    }

    /// The covariance of a mapped point: `A Σ Aᵀ`.
    #[must_use]
    pub fn apply_to_covariance(&self, covariance: &Matrix2<f64>) -> Matrix2<f64> {
        let linear = Matrix2::from_diagonal(&self.scale);
        linear * covariance * linear
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn inverse_undoes(x in -1e3..1e3f64, y in -1e3..1e3f64, left in -50.0..500.0f64, side in 10.0..900.0f64) {
            let affine = AxisAlignedAffine::region_to_image(
                Vector2::new(left, -left), Vector2::new(side, 2.0 * side), Vector2::new(128.0, 64.0));
            let point = Vector2::new(x, y);
            prop_assert!((affine.inverse().apply(&affine.apply(&point)) - point).norm() < 1e-9);
        }
    }

    #[test]
    fn edges_of_the_region_become_edges_of_the_image() {
        let affine = AxisAlignedAffine::region_to_image(
            Vector2::new(10.0, 20.0),
            Vector2::new(64.0, 64.0),
            Vector2::new(128.0, 128.0),
        );
        assert_eq!(affine.apply(&Vector2::new(9.5, 19.5)), Vector2::new(-0.5, -0.5));
        assert_eq!(affine.apply(&Vector2::new(73.5, 83.5)), Vector2::new(127.5, 127.5));
    }
}
