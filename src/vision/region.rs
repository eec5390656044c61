//! Parts of an image: boxes, and the squares that crops are cut from.

use nalgebra::Vector2;
use posed_core::geometry::Affine;

/// A box in image pixels; `x`, `y` is the top left pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingBox {
    pub x: f64,
    pub y: f64,
    pub width: f64,
    pub height: f64,
}

impl BoundingBox {
    /// What an image of this size shows of the box between two corners, its edges in pixels; `None` where that is no two pixels
    /// wide or high.
    #[must_use]
    pub fn within(first: &Vector2<f64>, last: &Vector2<f64>, image_size: &Vector2<f64>) -> Option<Self> {
        let (first, last) = (first.sup(&Vector2::zeros()), last.inf(image_size));
        let size = last - first;
        (size.min() >= 2.0).then_some(Self { x: first.x, y: first.y, width: size.x, height: size.y })
    }

    /// The larger side.
    #[must_use]
    pub fn extent(&self) -> f64 {
        self.width.max(self.height)
    }

    /// Intersection over union with another box, 0..1.
    #[must_use]
    pub fn overlap(&self, other: &Self) -> f64 {
        let intersection = self.intersection(other);
        let union = self.area() + other.area() - intersection;
        if union > 0.0 { intersection / union } else { 0.0 }
    }

    /// Share of the smaller of two boxes that lies in the other, 0..1.
    #[must_use]
    pub fn shared(&self, other: &Self) -> f64 {
        let smaller = self.area().min(other.area());
        if smaller > 0.0 { self.intersection(other) / smaller } else { 0.0 }
    }

    fn area(&self) -> f64 {
        self.width * self.height
    }

    fn intersection(&self, other: &Self) -> f64 {
        let common = |a: f64, a_size: f64, b: f64, b_size: f64| ((a + a_size).min(b + b_size) - a.max(b)).max(0.0);
        common(self.x, self.width, other.x, other.width) * common(self.y, self.height, other.y, other.height)
    }

    /// The centre, in pixel coordinates (centres of pixels at integers).
    #[must_use]
    pub fn centre(&self) -> Vector2<f64> {
        Vector2::new(self.x + (self.width - 1.0) / 2.0, self.y + (self.height - 1.0) / 2.0)
    }
}

/// x, y, width, height.
impl From<[f64; 4]> for BoundingBox {
    fn from([x, y, width, height]: [f64; 4]) -> Self {
        Self { x, y, width, height }
    }
}

/// x, y, width, height.
impl From<BoundingBox> for [f64; 4] {
    fn from(region: BoundingBox) -> Self {
        [region.x, region.y, region.width, region.height]
    }
}

/// A square of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Square {
    /// Pixels, with the pixels' centres at integers.
    pub centre: Vector2<f64>,
    /// Pixels.
    pub side: f64,
    /// By how much the image is turned about the centre before it is cut, radians, clockwise.
    pub turn: f64,
}

/// Largest crop, in image pixels: a box may reach beyond the image, but its padding must stay bounded.
const MAX_CROP_PX: f64 = 32_768.0;

impl Square {
    /// As large as the larger side of a box.
    #[must_use]
    pub fn around(region: &BoundingBox) -> Self {
        Self { centre: region.centre(), side: region.extent(), turn: 0.0 }
    }

    /// About the same centre.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { side: self.side * factor, ..self }
    }

    /// About the same centre, by so many radians more.
    #[must_use]
    pub fn turned(self, angle: f64) -> Self {
        Self { turn: self.turn + angle, ..self }
    }

    pub(super) fn is_bounded(&self) -> bool {
        let bounded = |value: f64| value.abs() <= MAX_CROP_PX; // false for NaN
        self.side >= 1.0 && bounded(self.side) && self.centre.iter().copied().all(bounded) && self.turn.is_finite()
    }

    /// Image pixels to those of a crop of `size` x `size`.
    pub(super) fn crop_from_image(&self, size: u32) -> Affine {
        let middle = Vector2::repeat(f64::from(size - 1) / 2.0);
        Affine::similarity(f64::from(size) / self.side, self.turn, self.centre, middle)
    }

    /// Left and top edge when not turned; edge = pixel centre + 0.5.
    pub(super) fn top_left(&self) -> Vector2<f64> {
        self.centre.add_scalar(0.5 - self.side / 2.0)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp, reason = "exact values")]

    use super::*;

    #[test]
    fn overlap_is_intersection_over_union() {
        let at = |x: f64| BoundingBox { x, y: 0.0, width: 10.0, height: 4.0 };
        assert_eq!(at(0.0).overlap(&at(0.0)), 1.0);
        assert!((at(0.0).overlap(&at(5.0)) - 20.0 / 60.0).abs() < 1e-12);
        assert_eq!(at(0.0).overlap(&at(30.0)), 0.0);
    }
}
