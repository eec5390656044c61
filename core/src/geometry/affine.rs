use nalgebra::{Matrix2, Rotation2, Vector2};

/// A 2D map `to = linear * from + offset` of pixel coordinates: what crops and letterboxes do to an image.
///
/// Both sides have pixel centres at integers, so a plain resize by `s` is `linear = s I`, `offset = (s - 1) / 2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    linear: Matrix2<f64>,
    offset: Vector2<f64>,
}

impl Affine {
    /// The map that takes the region with this top left corner and size (in pixel-EDGE coordinates: the image
    /// spans 0 to its width) to an image of `to` pixels.
    #[must_use]
    pub fn region_to_image(top_left: Vector2<f64>, size: Vector2<f64>, to: Vector2<f64>) -> Self {
        let scale = to.component_div(&size);
        let half = Vector2::repeat(0.5);
        Self { linear: Matrix2::from_diagonal(&scale), offset: (half - top_left).component_mul(&scale) - half }
    }

    /// The map that scales, turns by so many radians (from x to y), and takes `from` to `to`. The scale must not be 0.
    #[must_use]
    pub fn similarity(scale: f64, turn: f64, from: Vector2<f64>, to: Vector2<f64>) -> Self {
        let linear = scale * Rotation2::new(turn).into_inner();
        Self { linear, offset: to - linear * from }
    }

    /// Where a point is mapped to, pixels.
    #[must_use]
    pub fn apply(&self, point: &Vector2<f64>) -> Vector2<f64> {
        self.linear * point + self.offset
    }

    /// The map back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        // By construction there is one: the adjugate over the determinant.
        let Matrix2 { data, .. } = self.linear;
        let [[a, c], [b, d]] = data.0;
        let linear = Matrix2::new(d, -b, -c, a) / (a * d - b * c);
        Self { linear, offset: -(linear * self.offset) }
    }

    /// The covariance of a mapped point: `A Σ Aᵀ`.
    #[must_use]
    pub fn apply_to_covariance(&self, covariance: &Matrix2<f64>) -> Matrix2<f64> {
        self.linear * covariance * self.linear.transpose()
    }
}

impl std::ops::Mul for Affine {
    type Output = Self;

    /// `a_from_c = a_from_b * b_from_c`.
    fn mul(self, other: Self) -> Self {
        Self { linear: self.linear * other.linear, offset: self.apply(&other.offset) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A turn and a scale after a stretch, as of a crop of a resized image.
    fn any_affine() -> impl Strategy<Value = Affine> {
        let places = prop::array::uniform4(-500.0..500.0f64);
        let sizes = prop::array::uniform4(1.0..500.0f64);
        (places, sizes, 0.1..3.0f64, -4.0..4.0f64).prop_map(|([x, y, u, v], [w, h, to_w, to_h], scale, turn)| {
            let stretch = Affine::region_to_image(Vector2::new(x, y), Vector2::new(w, h), Vector2::new(to_w, to_h));
            Affine::similarity(scale, turn, Vector2::new(u, v), Vector2::new(x, y)) * stretch
        })
    }

    proptest! {
        #[test]
        fn inverse_undoes(affine in any_affine(), point in prop::array::uniform2(-1e3..1e3f64)) {
            let point = Vector2::from(point);
            prop_assert!((affine.inverse().apply(&affine.apply(&point)) - point).norm() < 1e-6);
        }

        #[test]
        fn composition_is_application_in_turn(
            a in any_affine(), b in any_affine(), point in prop::array::uniform2(-1e3..1e3f64),
        ) {
            let point = Vector2::from(point);
            let apart = (a * b).apply(&point) - a.apply(&b.apply(&point));
            prop_assert!(apart.norm() < 1e-9 * (1.0 + a.apply(&b.apply(&point)).norm()).max(1e3));
        }

        #[test]
        fn covariance_follows_the_points(affine in any_affine(), step in prop::array::uniform2(-1.0..1.0f64)) {
            let step = Vector2::from(step);
            let mapped = affine.apply(&step) - affine.apply(&Vector2::zeros());
            let covariance = affine.apply_to_covariance(&(step * step.transpose()));
            prop_assert!((covariance - mapped * mapped.transpose()).amax() < 1e-6 * (1.0 + mapped.norm_squared()));
        }
    }

    #[test]
    fn edges_of_the_region_become_edges_of_the_image() {
        let affine =
            Affine::region_to_image(Vector2::new(10.0, 20.0), Vector2::new(64.0, 64.0), Vector2::new(128.0, 128.0));
        assert_eq!(affine.apply(&Vector2::new(9.5, 19.5)), Vector2::new(-0.5, -0.5));
        assert_eq!(affine.apply(&Vector2::new(73.5, 83.5)), Vector2::new(127.5, 127.5));
    }
}
