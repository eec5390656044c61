//! Images as camera drivers give them, not encoded: their layout, and the way to RGB.

mod bayer;
mod encoding;
mod error;
#[cfg(test)]
mod tests;

use std::str::FromStr;

use bytes::Bytes;
use image::RgbImage;
use yuv::{YuvBiPlanarImage, YuvConversionMode, YuvError, YuvPackedImage, YuvRange, YuvStandardMatrix};
use yuv::{yuv_nv12_to_rgb, yuyv422_to_rgb};

use bayer::BayerPattern;
pub use encoding::RawEncoding;
pub use error::RawError;

/// How a raw image lies in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawLayout {
    pub encoding: RawEncoding,
    pub width: u32,
    pub height: u32,
    /// Bytes from one row to the next; rows without padding where there is none.
    pub step: Option<u32>,
}

/// `ENCODING:WIDTHxHEIGHT[:STEP]`
impl FromStr for RawLayout {
    type Err = RawError;

    fn from_str(text: &str) -> Result<Self, RawError> {
        let wrong = || RawError::Layout(text.to_owned());
        let number = |digits: &str| digits.parse().map_err(|_| wrong());
        let (encoding, rest) = text.split_once(':').ok_or_else(wrong)?;
        let (size, step) = rest.split_once(':').map_or((rest, None), |(size, step)| (size, Some(step)));
        let (width, height) = size.split_once('x').ok_or_else(wrong)?;
        Ok(Self {
            encoding: encoding.parse()?,
            width: number(width)?,
            height: number(height)?,
            step: step.map(number).transpose()?,
        })
    }
}

impl FromStr for RawEncoding {
    type Err = RawError;

    fn from_str(name: &str) -> Result<Self, RawError> {
        let known = Self::ALL.into_iter().find(|encoding| encoding.name() == name);
        known.ok_or_else(|| RawError::UnknownEncoding(name.to_owned()))
    }
}

/// A raw image whose data has the size that its layout says.
#[derive(Clone, Debug)]
pub struct RawImage {
    encoding: RawEncoding,
    width: u32,
    height: u32,
    step: u32,
    data: Bytes,
}

impl RawImage {
    /// # Errors
    /// [`RawError`] says what does not fit.
    pub fn new(layout: RawLayout, data: Bytes) -> Result<Self, RawError> {
        let RawLayout { encoding, width, height, step } = layout;
        if width == 0 || height == 0 {
            return Err(RawError::Empty { width, height });
        }
        let (cell_width, cell_height) = encoding.cell();
        if width % cell_width != 0 || height % cell_height != 0 {
            return Err(RawError::Odd { encoding, width, height, cell_width, cell_height });
        }
        let row = u64::from(width) * u64::from(encoding.bytes_per_pixel());
        let step = step.map_or(row, u64::from);
        let Some(step) = u32::try_from(step).ok().filter(|_| step >= row) else {
            return Err(RawError::Step { step, encoding, width, row });
        };
        // NV12's chroma takes half as many rows as its luma.
        let rows = u64::from(height) + if encoding == RawEncoding::Nv12 { u64::from(height / 2) } else { 0 };
        // Data is never as long as what a product too large for its type becomes.
        let expected = u64::from(step).saturating_mul(rows);
        let length = data.len();
        if length as u64 != expected {
            return Err(RawError::Length { length, expected, encoding, width, height, step, rows });
        }
        Ok(Self { encoding, width, height, step, data })
    }

    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Bytes that it takes as it came.
    #[must_use]
    pub fn byte_count(&self) -> usize {
        self.data.len()
    }

    /// YUV is read as BT.601 in its limited range, as OpenCV does; Bayer patterns are interpolated linearly.
    #[must_use]
    pub fn to_rgb(&self) -> RgbImage {
        match self.encoding {
            RawEncoding::Rgb8 => self.picked(|[r, g, b]: [u8; 3]| [r, g, b]),
            RawEncoding::Bgr8 => self.picked(|[b, g, r]: [u8; 3]| [r, g, b]),
            RawEncoding::Rgba8 => self.picked(|[r, g, b, _]: [u8; 4]| [r, g, b]),
            RawEncoding::Bgra8 => self.picked(|[b, g, r, _]: [u8; 4]| [r, g, b]),
            RawEncoding::Mono8 => self.picked(|[grey]: [u8; 1]| [grey; 3]),
            RawEncoding::Nv12 => self.nv12(),
            RawEncoding::Yuv422Yuy2 => self.yuy2(),
            RawEncoding::BayerRggb8 => self.demosaiced(0, 0),
            RawEncoding::BayerGrbg8 => self.demosaiced(1, 0),
            RawEncoding::BayerGbrg8 => self.demosaiced(0, 1),
            RawEncoding::BayerBggr8 => self.demosaiced(1, 1),
        }
    }

    /// Of encodings with `N` bytes a pixel that hold their RGB.
    fn picked<const N: usize>(&self, rgb: impl Fn([u8; N]) -> [u8; 3]) -> RgbImage {
        let mut image = RgbImage::new(self.width, self.height);
        for (line, row) in image.rows_mut().zip(self.data.chunks_exact(self.step as usize)) {
            for (pixel, stored) in line.zip(row.as_chunks().0) {
                pixel.0 = rgb(*stored);
            }
        }
        image
    }

    fn demosaiced(&self, red_x: u32, red_y: u32) -> RgbImage {
        BayerPattern { red_x, red_y }.demosaic(&self.data, self.step as usize, self.width, self.height)
    }

    fn nv12(&self) -> RgbImage {
        let Self { width, height, step, .. } = *self;
        let (y_plane, uv_plane) = self.data.split_at(step as usize * height as usize);
        let planes = YuvBiPlanarImage { y_plane, y_stride: step, uv_plane, uv_stride: step, width, height };
        self.converted(|rgb, row| {
            let mode = YuvConversionMode::Balanced;
            yuv_nv12_to_rgb(&planes, rgb, row, YuvRange::Limited, YuvStandardMatrix::Bt601, mode)
        })
    }

    fn yuy2(&self) -> RgbImage {
        let Self { width, height, step, .. } = *self;
        let packed = YuvPackedImage { yuy: &self.data, yuy_stride: step, width, height };
        self.converted(|rgb, row| yuyv422_to_rgb(&packed, rgb, row, YuvRange::Limited, YuvStandardMatrix::Bt601))
    }

    fn converted(&self, convert: impl FnOnce(&mut [u8], u32) -> Result<(), YuvError>) -> RgbImage {
        let mut image = RgbImage::new(self.width, self.height);
        if let Err(error) = convert(&mut image, 3 * self.width) {
            unreachable!("sizes are checked when a raw image is made: {error}");
        }
        image
    }
}
