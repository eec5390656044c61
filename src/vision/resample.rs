use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;
use nalgebra::Vector2;
use thiserror::Error;

use super::region::Square;
use posed_core::geometry::Affine;

/// Pixels made for a network, with the map from the image's pixels to theirs.
#[derive(Clone, Debug)]
pub struct Resampled {
    /// RGB, row by row.
    pub rgb: Vec<u8>,
    pub crop_from_image: Affine,
}

/// A region that cannot be resampled.
#[derive(Clone, Debug, Error)]
pub enum ResampleError {
    #[error("{0:?} does not describe a region of the image")]
    Region(Square),
    #[error("resampling failed: {0}")]
    Resize(#[from] fast_image_resize::ResizeError),
    #[error("resampling failed: {0}")]
    Buffer(#[from] fast_image_resize::ImageBufferError),
}

/// How a whole image becomes a network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Letterbox {
    pub width: u32,
    pub height: u32,
    /// Grey value of what the image does not cover.
    pub fill: u8,
    pub fit: Fit,
}

/// Where an image lies in an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// Its aspect kept.
    TopLeft,
    /// Its aspect kept, in the middle.
    Centre,
    /// Over the whole input.
    Stretch,
}

/// The whole image resized to fit into a letterbox.
///
/// # Errors
/// When the image is empty.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rounded sides within 1..=width")]
pub fn letterbox(resizer: &mut Resizer, image: &RgbImage, to: Letterbox) -> Result<Resampled, ResampleError> {
    let Letterbox { width, height, fill, fit } = to;
    let from = Vector2::new(f64::from(image.width()), f64::from(image.height()));
    let scale = (f64::from(width) / from.x).min(f64::from(height) / from.y);
    let (inner_width, inner_height) = if fit == Fit::Stretch {
        (width, height)
    } else {
        let side = |side: f64, most: u32| ((side * scale).round() as u32).clamp(1, most);
        (side(from.x, width), side(from.y, height))
    };
    let inner = resize(resizer, image, (inner_width, inner_height), ResizeOptions::new())?;
    let (left, top) =
        if fit == Fit::Centre { ((width - inner_width) / 2, (height - inner_height) / 2) } else { (0, 0) };
    let mut rgb = vec![fill; 3 * width as usize * height as usize];
    for (row, line) in inner.chunks_exact(3 * inner_width as usize).enumerate() {
        let start = 3 * ((row + top as usize) * width as usize + left as usize);
        rgb[start..start + line.len()].copy_from_slice(line);
    }
    let pixel = from.component_div(&Vector2::new(f64::from(inner_width), f64::from(inner_height)));
    let crop_from_image = Affine::region_to_image(
        -Vector2::new(f64::from(left), f64::from(top)).component_mul(&pixel),
        Vector2::new(f64::from(width), f64::from(height)).component_mul(&pixel),
        Vector2::new(f64::from(width), f64::from(height)),
    );
    Ok(Resampled { rgb, crop_from_image })
}

/// Bilinear, antialiased when shrinking; `region` says which part of the image.
pub(super) fn resize(
    resizer: &mut Resizer,
    image: &RgbImage,
    (width, height): (u32, u32),
    region: ResizeOptions,
) -> Result<Vec<u8>, ResampleError> {
    let source = ImageRef::new(image.width(), image.height(), image.as_raw(), PixelType::U8x3)?;
    let mut target = Image::new(width, height, PixelType::U8x3);
    let options = region.resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    resizer.resize(&source, &mut target, &options)?;
    Ok(target.into_vec())
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::cast_possible_truncation, reason = "small test images")]

    use super::*;
    use image::Rgb;

    /// A picture whose colour says where it is.
    pub(in crate::vision) fn map(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, y as u8, 77]))
    }

    pub(in crate::vision) fn pixel(resampled: &Resampled, width: u32, x: u32, y: u32) -> [u8; 3] {
        let at = 3 * (y * width + x) as usize;
        resampled.rgb[at..at + 3].try_into().unwrap()
    }

    #[test]
    fn letterbox_keeps_the_aspect_and_fills_the_rest() {
        let image = map(200, 100);
        for (fit, filled, corner) in
            [(Fit::TopLeft, 80, Vector2::new(99.5, 49.5)), (Fit::Centre, 10, Vector2::new(99.5, 74.5))]
        {
            let to = Letterbox { width: 100, height: 100, fill: 114, fit };
            let boxed = letterbox(&mut Resizer::new(), &image, to).unwrap();
            assert_eq!(pixel(&boxed, 100, 50, filled), [114; 3]);
            assert_eq!(pixel(&boxed, 100, 50, 45)[2], 77);
            assert_eq!(boxed.crop_from_image.apply(&Vector2::new(199.5, 99.5)), corner);
        }
    }

    #[test]
    fn a_stretched_image_fills_the_input() {
        let to = Letterbox { width: 50, height: 100, fill: 114, fit: Fit::Stretch };
        let stretched = letterbox(&mut Resizer::new(), &map(200, 100), to).unwrap();
        assert_eq!(stretched.crop_from_image.apply(&Vector2::new(199.5, 99.5)), Vector2::new(49.5, 99.5));
        for (x, y, wanted) in [(0, 99, [2, 99, 77]), (49, 0, [198, 0, 77]), (25, 50, [102, 50, 77])] {
            let found = pixel(&stretched, 50, x, y);
            assert!(found.iter().zip(wanted).all(|(found, wanted)| found.abs_diff(wanted) <= 1), "{found:?}");
        }
    }
}
