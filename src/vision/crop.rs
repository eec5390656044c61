//! Square crops, as the trainer (`training/posed_train/crops.py`) cuts them.

use std::num::Wrapping;
use std::ops::RangeInclusive;

use fast_image_resize::{ResizeOptions, Resizer};
use image::RgbImage;
use nalgebra::Vector2;

use super::region::Square;
use super::resample::{ResampleError, Resampled, resize};
use posed_core::geometry::Affine;

/// Turned squares whose sides differ more are each resized by themselves: the larger one would not be antialiased.
const SHARED_RATIOS: RangeInclusive<f64> = 0.8..=1.25;

/// Squares, each resized to `size` x `size` pixels: bilinear, antialiased when shrinking. What lies outside the image is
/// black.
///
/// # Errors
/// When a square is empty, not finite, or far larger than an image.
pub fn crop_squares(
    resizer: &mut Resizer,
    image: &RgbImage,
    squares: &[Square],
    size: u32,
) -> Result<Vec<Resampled>, ResampleError> {
    let usable = |square: &Square| square.is_bounded() && size > 0;
    if let Some(square) = squares.iter().find(|square| !usable(square)) {
        return Err(ResampleError::Region(*square));
    }
    let turned: Vec<Square> = squares.iter().filter(|square| square.turn != 0.0).copied().collect();
    let shared = if alike(&turned) { Some(Canvas::holding(resizer, image, &turned, size)?) } else { None };
    let cut = |square: &Square| {
        let crop_from_image = square.crop_from_image(size);
        let rgb = match &shared {
            _ if square.turn == 0.0 => cut_upright(resizer, image, square, size)?,
            Some(canvas) => canvas.sample(&crop_from_image, size),
            None => Canvas::holding(resizer, image, &[*square], size)?.sample(&crop_from_image, size),
        };
        Ok(Resampled { rgb, crop_from_image })
    };
    squares.iter().map(cut).collect()
}

/// Whether there are squares here, and all can be sampled from the same pixels.
fn alike(squares: &[Square]) -> bool {
    let [first, others @ ..] = squares else { return false };
    let like_first =
        |other: &Square| other.centre == first.centre && SHARED_RATIOS.contains(&(other.side / first.side));
    others.iter().all(like_first)
}

fn cut_upright(resizer: &mut Resizer, image: &RgbImage, square: &Square, size: u32) -> Result<Vec<u8>, ResampleError> {
    let (top_left, side) = (square.top_left(), square.side);
    let inside = top_left.min() >= 0.0 && (size_of(image) - top_left).min() >= side;
    if inside {
        return resize(resizer, image, (size, size), ResizeOptions::new().crop(top_left.x, top_left.y, side, side));
    }
    let padded = Padded::new(resizer, image, square)?;
    let (top_left, side) = ((top_left - padded.origin) / padded.step, side / padded.step);
    // But for rounding there is always as much as the square needs.
    let available = size_of(&padded.canvas) - top_left;
    let region = ResizeOptions::new().crop(top_left.x, top_left.y, side.min(available.x), side.min(available.y));
    resize(resizer, &padded.canvas, (size, size), region)
}

/// A square's surroundings where it reaches beyond the image: black there.
struct Padded {
    canvas: RgbImage,
    /// Of the canvas, in edge coordinates of the image.
    origin: Vector2<f64>,
    /// Image pixels to one of the canvas, each way.
    step: f64,
}

/// Largest side of a canvas. A box of a large image may reach far beyond it; that must not cost as much memory again.
const MAX_CANVAS_SIDE: f64 = 2048.0;

/// What cutting a crop takes at most: a canvas and the part of the image in it, with some pixels more on every side.
pub const MAX_CANVAS_BYTES: u64 = 2 * 3 * 2060 * 2060;

impl Padded {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "sides of at most MAX_CANVAS_SIDE")]
    fn new(resizer: &mut Resizer, image: &RgbImage, square: &Square) -> Result<Self, ResampleError> {
        let step = (square.side / MAX_CANVAS_SIDE).ceil().max(1.0);
        let (first, last) = (square.top_left(), square.top_left().add_scalar(square.side));
        let (first, last) = (first.map(f64::floor), last.map(f64::ceil));
        let (from, to) = (first.sup(&Vector2::zeros()), last.inf(&size_of(image)));
        // Whole steps: at the far edges less than one of them is lost.
        let pixels = ((to - from) / step).map(|side| side.floor().max(0.0));
        let before = ((from - first) / step).map(f64::ceil);
        let origin = from - before * step;
        let size = ((last - origin) / step).map(|side| side.ceil().max(1.0) as u32);
        let mut canvas = RgbImage::new(size.x, size.y);
        if pixels.min() > 0.0 {
            let to = pixels.map(|side| side as u32);
            let region = ResizeOptions::new().crop(from.x, from.y, pixels.x * step, pixels.y * step);
            let part = RgbImage::from_raw(to.x, to.y, resize(resizer, image, (to.x, to.y), region)?);
            if let Some(part) = part {
                image::imageops::replace(&mut canvas, &part, before.x as i64, before.y as i64);
            }
        }
        Ok(Self { canvas, origin, step })
    }
}

fn size_of(image: &RgbImage) -> Vector2<f64> {
    Vector2::new(f64::from(image.width()), f64::from(image.height()))
}

/// An upright part of an image, from which turned squares are sampled.
struct Canvas {
    /// Row by row, each pixel's channels in the lanes of one number.
    lanes: Vec<Wrapping<u64>>,
    /// Pixels of a side.
    size: u32,
    /// Image pixels to those of the canvas.
    from_image: Affine,
}

/// Bits of a lane: a level times all of [`WEIGHT`], rounded, fits.
const LANE: u32 = 21;
/// Binary places of the weights of the four pixels around a sample.
const WEIGHT: u32 = 13;
/// Binary places of the coordinates.
const POINT: u32 = 16;

impl Canvas {
    /// The smallest that holds these squares about one centre, with the resolution of the smallest of them and a pixel
    /// more on every side.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "about 1 to 2 times a size")]
    fn holding(resizer: &mut Resizer, image: &RgbImage, squares: &[Square], size: u32) -> Result<Self, ResampleError> {
        let pixel = squares.iter().map(|square| square.side).fold(f64::INFINITY, f64::min) / f64::from(size);
        let reach = squares.iter().map(|square| square.side * (square.turn.cos().abs() + square.turn.sin().abs()));
        let canvas_size = (reach.fold(0.0, f64::max) / pixel).ceil() + 2.0;
        let around = Square { centre: squares[0].centre, side: canvas_size * pixel, turn: 0.0 };
        let size = canvas_size as u32;
        let rgb = cut_upright(resizer, image, &around, size)?;
        let spread =
            |rgb: &[u8]| Wrapping(u64::from(rgb[0]) | u64::from(rgb[1]) << LANE | u64::from(rgb[2]) << (2 * LANE));
        let lanes = rgb.chunks_exact(3).map(spread).collect();
        Ok(Self { lanes, size, from_image: around.crop_from_image(size) })
    }

    /// One of the squares, bilinear, as `size` x `size` pixels.
    ///
    /// In fixed point and with the channels in one number, since libraries that sample in floats with checks at each
    /// pixel take more than ten times as long; and wrapping, since checks for overflow double the time again. All
    /// places are within the canvas, and a lane holds what is summed in it.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the canvas; single channels")]
    fn sample(&self, crop_from_image: &Affine, size: u32) -> Vec<u8> {
        let canvas_from_crop = self.from_image * crop_from_image.inverse();
        let fixed = |value: f64| Wrapping((value * f64::from(1u32 << POINT)).round() as i64);
        let place = |u: u32, v: u32| canvas_from_crop.apply(&Vector2::new(f64::from(u), f64::from(v)));
        let step = (place(1, 0) - place(0, 0)).map(fixed);
        let one = Wrapping(1 << WEIGHT);
        let half = Wrapping((1 << (WEIGHT - 1)) * (1 | 1 << LANE | 1 << (2 * LANE)));
        let fraction = |at: Wrapping<i64>| Wrapping((at.0 >> (POINT - 8)) as u64 & 255);
        let stride = self.size as usize;
        let mut rgb = vec![0; 3 * size as usize * size as usize];
        for (v, row) in (0..size).zip(rgb.chunks_exact_mut(3 * size as usize)) {
            let mut at = place(0, v).map(fixed);
            for pixel in row.as_chunks_mut::<3>().0 {
                let (right, below) = (fraction(at.x), fraction(at.y));
                let both = (right * below) >> (16 - WEIGHT as usize);
                let (right, below) = (right << (WEIGHT as usize - 8), below << (WEIGHT as usize - 8));
                let start = ((at.y.0 >> POINT) as usize).wrapping_mul(stride).wrapping_add((at.x.0 >> POINT) as usize);
                let around = &self.lanes[start..];
                let sum = around[0] * (one + both - right - below)
                    + around[1] * (right - both)
                    + around[stride] * (below - both)
                    + around[stride + 1] * both
                    + half;
                let level = |lane: u32| (sum.0 >> (lane * LANE + WEIGHT)) as u8;
                *pixel = [level(0), level(1), level(2)];
                at.x += step.x;
                at.y += step.y;
            }
        }
        rgb
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small test images")]

    use super::*;
    use crate::vision::BoundingBox;
    use crate::vision::resample::tests::{map, pixel};
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn crop(image: &RgbImage, square: Square, size: u32) -> Resampled {
        crop_squares(&mut Resizer::new(), image, &[square], size).unwrap().remove(0)
    }

    proptest! {
        #[test]
        fn crop_pixels_lie_where_the_affine_says(
            size in 32u32..200, side in 20.0..90.0f64, turn in prop_oneof![Just(0.0), -7.0..7.0f64],
            other_side in 0.7..1.15f64, other_turn in -1.0..1.0f64, column in 0.0..1.0f64, row in 0.0..1.0f64,
        ) {
            let square = Square { centre: Vector2::new(100.4, 74.7), side, turn };
            let squares = [square, square.scaled(other_side).turned(other_turn)];
            let crops = crop_squares(&mut Resizer::new(), &map(200, 150), &squares, size).unwrap();
            let [x, y] = [column, row].map(|share| (share * f64::from(size - 1)) as u32);
            for (crop, square) in crops.iter().zip(&squares) {
                let at = crop.crop_from_image.inverse().apply(&Vector2::new(f64::from(x), f64::from(y)));
                let [red, green, blue] = pixel(crop, size, x, y);
                // A turned crop is rounded to whole levels twice.
                let tolerance = if square.turn == 0.0 { 1.0 } else { 1.3 };
                prop_assert!((f64::from(red) - at.x).abs() < tolerance, "{} {}", red, at);
                prop_assert!((f64::from(green) - at.y).abs() < tolerance, "{} {}", green, at);
                prop_assert_eq!(blue, 77);
            }
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
            let crop = crop(&image, square, size);
            let worst = crop.rgb.iter().zip(open(name).as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(worst <= Some(tolerance), "{name}: differs by {worst:?}");
        }
    }

    #[test]
    fn crops_that_share_their_pixels_show_the_same() {
        let image = image::open("samples/sample-1.jpg").unwrap().into_rgb8();
        let square = Square { centre: Vector2::new(300.2, 240.9), side: 180.0, turn: 0.4 };
        let squares = [square.scaled(0.95).turned(-0.17), square, square.scaled(1.05).turned(0.17)];
        let shared = crop_squares(&mut Resizer::new(), &image, &squares, 96).unwrap();
        for (shared, square) in shared.iter().zip(squares) {
            let alone = crop(&image, square, 96);
            assert_eq!(shared.crop_from_image, alone.crop_from_image);
            let apart: u32 = shared.rgb.iter().zip(&alone.rgb).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
            let mean = f64::from(apart) / alone.rgb.len() as f64;
            assert!(mean < 0.5, "differs by {mean} levels in the mean");
        }
    }

    #[test]
    fn a_crop_beyond_the_image_is_black_there() {
        let square = Square { centre: Vector2::new(-0.5, 59.5), side: 60.0, turn: 0.0 };
        let border = crop(&map(100, 100), square, 64);
        assert_eq!(pixel(&border, 64, 2, 32), [0, 0, 0]);
        assert_eq!(pixel(&border, 64, 62, 32)[2], 77);
        let over = crop(&map(100, 100), square.turned(PI), 64);
        assert_eq!(pixel(&over, 64, 62, 32), [0, 0, 0]);
        assert_eq!(pixel(&over, 64, 2, 32)[2], 77);
    }

    /// A box that reaches beyond a large image is cut from a shrunken part of it, to the same place.
    #[test]
    fn a_large_crop_beyond_the_image_lies_where_the_affine_says() {
        let image = RgbImage::from_fn(5000, 3000, |x, y| image::Rgb([(x / 20) as u8, (y / 12) as u8, 77]));
        let square = Square { centre: Vector2::new(3100.4, 900.7), side: 4700.0, turn: 0.0 };
        for square in [square, square.turned(0.2)] {
            let crop = crop(&image, square, 200);
            for (x, y) in [(100, 130), (20, 80), (160, 150)] {
                let at = crop.crop_from_image.inverse().apply(&Vector2::new(f64::from(x), f64::from(y)));
                let [red, green, blue] = pixel(&crop, 200, x, y);
                // Levels are steps of 20 and 12 pixels.
                assert!((20.0 * f64::from(red) + 9.5 - at.x).abs() < 21.0, "{red} {at}");
                assert!((12.0 * f64::from(green) + 5.5 - at.y).abs() < 13.0, "{green} {at}");
                assert_eq!(blue, 77);
            }
            assert_eq!(pixel(&crop, 200, 100, 2), [0, 0, 0]);
        }
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
            assert!(crop_squares(&mut Resizer::new(), &image, &[square], 64).is_err(), "{square:?}");
        }
        let square = Square { centre: Vector2::new(20.0, 20.0), side: 10.0, turn: PI };
        assert_eq!(crop(&image, square, 1).rgb.len(), 3);
    }
}
