//! What an image demands, from its header alone: nothing of its size is allocated to find that out.
//!
//! Decoders trust their files, and some files lie: a few bytes may claim the largest frame, or tables hundreds of times
//! their own size. What is promised here are upper bounds for any file, read from the decoders' sources and measured on
//! images of 24 megapixels; typical files take less.

mod jpeg;
mod png;
mod webp;

use image::error::{DecodingError, ImageFormatHint};
use image::{ImageError, ImageFormat};

use super::decode::{DecodeError, DecodeOptions, OrientationPolicy};
use super::source::Image;

/// Smaller than this and no object could be seen in it.
pub(super) const MIN_SIDE_PX: u32 = 16;

/// Bytes of an RGB pixel.
const RGB: u64 = 3;

/// What an image is going to be, and to cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    pub width: u32,
    pub height: u32,
    /// At most so many bytes are allocated at once while it is decoded, the result among them.
    pub decode_bytes: u64,
    /// Bytes of the result.
    pub rgb_bytes: u64,
}

/// Reads the size of an image and checks it, and says what decoding takes.
///
/// # Errors
/// [`DecodeError`] says what is wrong with the header and which limit it breaks.
pub fn header(image: &Image, options: &DecodeOptions) -> Result<Header, DecodeError> {
    match image {
        Image::Encoded(bytes) => EncodedHeader::read(bytes)?.checked(options),
        Image::Raw(raw) => {
            let (width, height) = (raw.width(), raw.height());
            check_size(width, height, options)?;
            let rgb_bytes = RGB * u64::from(width) * u64::from(height);
            Ok(Header { width, height, decode_bytes: rgb_bytes, rgb_bytes })
        }
    }
}

/// What the header of a file says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct EncodedHeader {
    pub format: ImageFormat,
    pub width: u32,
    pub height: u32,
    /// Bytes of each pixel that the decoder gives, before it becomes RGB.
    pub output: u64,
    /// Bytes that the decoder takes beside its output.
    pub working: u64,
    /// Of these, bytes that a PNG decoder may take for text and profiles.
    pub metadata: u64,
}

impl EncodedHeader {
    pub(super) fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
        if bytes.is_empty() {
            return Err(DecodeError::Empty);
        }
        match image::guess_format(bytes) {
            Ok(ImageFormat::Jpeg) => jpeg::read(bytes),
            Ok(ImageFormat::Png) => png::read(bytes),
            Ok(ImageFormat::WebP) => webp::read(bytes),
            Ok(_) | Err(_) => Err(DecodeError::UnknownFormat),
        }
    }

    pub(super) fn checked(&self, options: &DecodeOptions) -> Result<Header, DecodeError> {
        let Self { width, height, output, working, .. } = *self;
        check_size(width, height, options)?;
        let pixels = u64::from(width) * u64::from(height);
        // Three stages, one after the other: decoding, then conversion to RGB where it is something else, then turning.
        let mut decode_bytes = output * pixels + working;
        if output != RGB {
            decode_bytes = decode_bytes.max((output + RGB) * pixels);
        }
        if options.exif_orientation == OrientationPolicy::Apply {
            decode_bytes = decode_bytes.max(2 * RGB * pixels);
        }
        Ok(Header { width, height, decode_bytes, rgb_bytes: RGB * pixels })
    }
}

fn check_size(width: u32, height: u32, options: &DecodeOptions) -> Result<(), DecodeError> {
    let DecodeOptions { max_side_px, max_pixels, .. } = *options;
    if width.max(height) > max_side_px || u64::from(width) * u64::from(height) > max_pixels {
        return Err(DecodeError::TooLarge { width, height, max_side_px, max_pixels });
    }
    if width.min(height) < MIN_SIDE_PX {
        return Err(DecodeError::TooSmall { width, height });
    }
    Ok(())
}

pub(super) fn damaged(format: ImageFormat, what: &str) -> DecodeError {
    DecodeError::Damaged(ImageError::Decoding(DecodingError::new(ImageFormatHint::Exact(format), what)))
}

/// A file's bytes, in which nothing beyond the end can be read.
#[derive(Clone, Copy)]
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn at<const N: usize>(self, position: usize) -> Result<[u8; N], DecodeError> {
        let field = self.0.get(position..).and_then(|rest| rest.first_chunk());
        field.copied().ok_or(DecodeError::Truncated)
    }
}
