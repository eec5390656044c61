use image::ImageFormat;

use super::facts::EncodedHeader;
use super::{jpeg, png, webp};
use crate::vision::error::{DecodeError, MIN_SIDE_PX};
use crate::vision::options::{DecodeOptions, OrientationPolicy};
use crate::vision::source::Image;

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

impl EncodedHeader {
    pub(in crate::vision) fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
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

    pub(in crate::vision) fn checked(&self, options: &DecodeOptions) -> Result<Header, DecodeError> {
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

pub(in crate::vision) fn check_size(width: u32, height: u32, options: &DecodeOptions) -> Result<(), DecodeError> {
    let DecodeOptions { max_side_px, max_pixels, .. } = *options;
    if width.max(height) > max_side_px || u64::from(width) * u64::from(height) > max_pixels {
        return Err(DecodeError::TooLarge { width, height, max_side_px, max_pixels });
    }
    if width.min(height) < MIN_SIDE_PX {
        return Err(DecodeError::TooSmall { width, height });
    }
    Ok(())
}
