use image::error::{DecodingError, ImageFormatHint};
use image::{ImageError, ImageFormat};
use thiserror::Error;

use super::raw::RawError;

/// Smaller than this and no object could be seen in it.
pub(super) const MIN_SIDE_PX: u32 = 16;

/// Bytes that are not an image to estimate poses from.
#[derive(Debug, Error)]
pub enum DecodeError {
    #[error("the image is empty; it must be a JPEG, PNG or WebP file")]
    Empty,
    #[error("the image is not a JPEG, PNG or WebP file; for a raw frame, set its encoding and size")]
    UnknownFormat,
    #[error(
        "the image is {width}x{height}; the limits are {max_side_px} pixels per side ('max_side_px') and {max_pixels} \
         pixels in total ('max_pixels')"
    )]
    TooLarge { width: u32, height: u32, max_side_px: u32, max_pixels: u64 },
    #[error("the image is {width}x{height}; it must have at least {MIN_SIDE_PX} pixels per side")]
    TooSmall { width: u32, height: u32 },
    #[error("the image is an animation; post one of its frames")]
    Animated,
    #[error("the image is truncated; post the whole file")]
    Truncated,
    #[error(
        "the image has EXIF orientation {0}, so it is unclear which pixels the camera parameters refer to; remove the \
         orientation from the file, or turn its pixels"
    )]
    Orientation(u8),
    #[error(transparent)]
    Raw(#[from] RawError),
    #[error("the image is damaged: {0}")]
    Damaged(#[source] ImageError),
}

/// What a format of ours says that no decoder says.
pub(super) fn damaged(format: ImageFormat, what: &str) -> DecodeError {
    DecodeError::Damaged(ImageError::Decoding(DecodingError::new(ImageFormatHint::Exact(format), what)))
}
