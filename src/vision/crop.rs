//! Square crops, as the trainer (`training/posed_train/crops.py`) cuts them.

use fast_image_resize::{ResizeOptions, Resizer};
use image::RgbImage;
use nalgebra::Vector2;

use super::resample::{BoundingBox, ResampleError, Resampled, resize};
use crate::geometry::Affine;

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

    /// Image pixels to those of a crop of `size` x `size`.
    fn crop_from_image(&self, size: u32) -> Affine {
        let middle = Vector2::repeat(f64::from(size - 1) / 2.0);
        Affine::similarity(f64::from(size) / self.side, self.turn, self.centre, middle)
    }

    /// Left and top edge when not turned; edge = pixel centre + 0.5.
    fn top_left(&self) -> Vector2<f64> {
        self.centre.add_scalar(0.5 - self.side / 2.0)
    }
}

/// A square resized to `size` x `size` pixels: bilinear, antialiased when shrinking. What lies outside the image is
/// black.
///
/// # Errors
/// When the square is empty, not finite, or far larger than an image.
pub fn crop_square(
    resizer: &mut Resizer,
    image: &RgbImage,
    square: &Square,
    size: u32,
) -> Result<Resampled, ResampleError> {
    let bounded = |value: f64| value.abs() <= MAX_CROP_PX; // false for NaN
    let finite = square.centre.iter().copied().all(bounded) && square.turn.is_finite();
    if !(square.side >= 1.0 && bounded(square.side) && finite && size > 0) {
        return Err(ResampleError::Region(*square));
    }
    let crop_from_image = square.crop_from_image(size);
    let rgb = if square.turn == 0.0 {
        cut_upright(resizer, image, square, size)?
    } else {
        let (around, around_size) = upright_around(square, size);
        let pixels = cut_upright(resizer, image, &around, around_size)?;
        let around_from_crop = around.crop_from_image(around_size) * crop_from_image.inverse();
        sample(&pixels, around_size, &around_from_crop, size)
    };
    Ok(Resampled { rgb, crop_from_image })
}

/// The smallest upright square that holds a turned one, of about the same resolution, and its size.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 1.42 of a size")]
fn upright_around(square: &Square, size: u32) -> (Square, u32) {
    let reach = square.turn.cos().abs() + square.turn.sin().abs();
    let around_size = (f64::from(size) * reach).ceil().max(2.0); // two pixels to sample between
    let around = Square { turn: 0.0, ..square.scaled(around_size / f64::from(size)) };
    (around, around_size as u32)
}

fn cut_upright(resizer: &mut Resizer, image: &RgbImage, square: &Square, size: u32) -> Result<Vec<u8>, ResampleError> {
    let top_left = square.top_left();
    let first = top_left.map(f64::floor);
    let last = top_left.add_scalar(square.side).map(f64::ceil);
    let image_size = Vector2::new(f64::from(image.width()), f64::from(image.height()));
    let inside = first.min() >= 0.0 && (image_size - last).min() >= 0.0;
    let padded;
    let (canvas, origin) = if inside {
        (image, Vector2::zeros())
    } else {
        padded = cut_padded(image, first, last);
        (&padded, first)
    };
    let offset = top_left - origin;
    let available = last - top_left;
    let region =
        ResizeOptions::new().crop(offset.x, offset.y, square.side.min(available.x), square.side.min(available.y));
    resize(resizer, canvas, (size, size), region)
}

/// The pixels between two corners (edge coordinates, whole numbers), black outside the image.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded by MAX_CROP_PX")]
fn cut_padded(image: &RgbImage, first: Vector2<f64>, last: Vector2<f64>) -> RgbImage {
    let (left, top) = (first.x as i64, first.y as i64);
    let size = (last - first).map(|side| side.max(1.0) as u32);
    let mut canvas = RgbImage::new(size.x, size.y);
    image::imageops::replace(&mut canvas, image, -left, -top);
    canvas
}

/// Binary places of the fixed-point coordinates.
const POINT: u32 = 16;

/// A turned square of an image of `from_size` x `from_size` pixels, bilinear, as `size` x `size` pixels. Every sample
/// must lie within the image, but for rounding.
///
/// In fixed point, since libraries that sample in floats with checks at each pixel take ten times as long.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within an image; weights up to 256")]
fn sample(from: &[u8], from_size: u32, image_from_crop: &Affine, size: u32) -> Vec<u8> {
    let fixed = |value: f64| (value * f64::from(1u32 << POINT)).round() as i64;
    let place = |u: u32, v: u32| image_from_crop.apply(&Vector2::new(f64::from(u), f64::from(v)));
    let step = (place(1, 0) - place(0, 0)).map(fixed);
    let stride = 3 * from_size as usize;
    let last = i64::from(from_size.saturating_sub(2)); // the pixel right of and below it is the image's last
    let within = |at: i64| {
        let pixel = (at >> POINT).clamp(0, last);
        let weight = ((at - (pixel << POINT)) >> (POINT - 8)).clamp(0, 256);
        (pixel as usize, weight as u32)
    };
    let mut rgb = vec![0; 3 * size as usize * size as usize];
    for (v, row) in (0..size).zip(rgb.chunks_exact_mut(3 * size as usize)) {
        let mut at = place(0, v).map(fixed);
        for pixel in row.chunks_exact_mut(3) {
            let ((x, right), (y, below)) = (within(at.x), within(at.y));
            let start = y * stride + 3 * x;
            let (upper, lower) = (&from[start..start + 6], &from[start + stride..start + stride + 6]);
            let weights = [(256 - right) * (256 - below), right * (256 - below), (256 - right) * below, right * below];
            for (channel, value) in pixel.iter_mut().enumerate() {
                let around = [upper[channel], upper[channel + 3], lower[channel], lower[channel + 3]];
                let sum: u32 = around.iter().zip(weights).map(|(value, weight)| u32::from(*value) * weight).sum();
                *value = ((sum + (1 << 15)) >> 16) as u8;
            }
            at += step;
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    #![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small test images")]

    use super::*;
    use crate::vision::resample::tests::{map, pixel};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn crop_pixels_lie_where_the_affine_says(
            size in 32u32..200, side in 20.0..90.0f64, turn in prop_oneof![Just(0.0), -7.0..7.0f64], column in 0.0..1.0f64, row in 0.0..1.0f64,
        ) {
            let square = Square { centre: Vector2::new(100.4, 74.7), side, turn };
            let crop = crop_square(&mut Resizer::new(), &map(200, 150), &square, size).unwrap();
            let [x, y] = [column, row].map(|share| (share * f64::from(size - 1)) as u32);
            let at = crop.crop_from_image.inverse().apply(&Vector2::new(f64::from(x), f64::from(y)));
            let [red, green, blue] = pixel(&crop, size, x, y);
            // A turned crop is rounded to whole levels twice.
            let tolerance = if turn == 0.0 { 1.0 } else { 1.3 };
            prop_assert!((f64::from(red) - at.x).abs() < tolerance, "{} {}", red, at);
            prop_assert!((f64::from(green) - at.y).abs() < tolerance, "{} {}", green, at);
            prop_assert_eq!(blue, 77);
        }
    }

    /// The trainer made these files and is tested against them, too.
    #[test]
    fn crops_are_the_trainers() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/crop_parity");
        let open = |name: &str| image::open(folder.join(name)).unwrap().into_rgb8();
        let image = open("image.png");
        for (name, size, [x, y, width, height], turn, tolerance) in [
            ("shrunk.png", 64, [20.5, 11.25, 150.0, 97.0], 0.0, 1),
            ("grown_beyond_the_border.png", 160, [150.0, 80.5, 60.0, 44.0], 0.0, 1),
            ("turned.png", 96, [60.25, 40.5, 70.0, 52.0], 0.4, 2),
        ] {
            let square = Square::around(&BoundingBox { x, y, width, height }).scaled(1.5).turned(turn);
            let crop = crop_square(&mut Resizer::new(), &image, &square, size).unwrap();
            let worst = crop.rgb.iter().zip(open(name).as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(worst <= Some(tolerance), "{name}: differs by {worst:?}");
        }
    }

    #[test]
    fn a_crop_beyond_the_image_is_black_there() {
        let square = Square { centre: Vector2::new(-0.5, 59.5), side: 60.0, turn: 0.0 };
        let crop = crop_square(&mut Resizer::new(), &map(100, 100), &square, 64).unwrap();
        assert_eq!(pixel(&crop, 64, 2, 32), [0, 0, 0]);
        assert_eq!(pixel(&crop, 64, 62, 32)[2], 77);
        let over = crop_square(&mut Resizer::new(), &map(100, 100), &square.turned(std::f64::consts::PI), 64).unwrap();
        assert_eq!(pixel(&over, 64, 62, 32), [0, 0, 0]);
        assert_eq!(pixel(&over, 64, 2, 32)[2], 77);
    }

    #[test]
    fn squares_that_are_no_region_are_refused() {
        let image = map(50, 50);
        for (x, side, turn) in [
            (0.0, 0.0, 0.0),
            (f64::NAN, 10.0, 0.0),
            (0.0, f64::INFINITY, 0.0),
            (1e9, 10.0, 0.0),
            (0.0, 1e9, 0.0),
            (0.0, 10.0, f64::NAN),
        ] {
            let square = Square { centre: Vector2::new(x, 0.0), side, turn };
            assert!(crop_square(&mut Resizer::new(), &image, &square, 64).is_err(), "{square:?}");
        }
        let square = Square { centre: Vector2::new(20.0, 20.0), side: 10.0, turn: std::f64::consts::PI };
        assert_eq!(crop_square(&mut Resizer::new(), &image, &square, 1).unwrap().rgb.len(), 3);
    }
}
