use image::error::{DecodingError, ImageFormatHint};
use image::{ImageError, ImageFormat};
use thiserror::Error;

use super::raw::RawError;

/// Smaller than this and no object could be seen in it.
pub(super) const MIN_SIDE_PX: u32 = 16;

/// Bytes that are not an image to estimate poses from.
#[derive(Debug, Error)]
pub enum DecodeError {
    #[error("the body is empty; post the bytes of a JPEG, PNG or WebP image")]
    Empty,
    #[error("the body is not a JPEG, PNG or WebP image (its first bytes are none of theirs)")]
    UnknownFormat,
    #[error("image is {width}x{height}; the limits are {max_side_px} pixels a side and {max_pixels} pixels in all")]
    TooLarge { width: u32, height: u32, max_side_px: u32, max_pixels: u64 },
    #[error("image is {width}x{height}; at least {MIN_SIDE_PX} pixels a side are needed")]
    TooSmall { width: u32, height: u32 },
    #[error("image is truncated: its last part is missing")]
    Truncated,
    #[error(
        "image asks to be turned (EXIF orientation {0}), so it is unclear which pixels the camera parameters mean; \
         post the pixels as the sensor read them, without an orientation, or choose 'apply' or 'ignore' as exif_orientation"
    )]
    Orientation(u8),
    #[error(transparent)]
    Raw(#[from] RawError),
    #[error("image is damaged: {0}")]
    Damaged(#[source] ImageError),
}

/// What a format of ours says that no decoder says.
pub(super) fn damaged(format: ImageFormat, what: &str) -> DecodeError {
    DecodeError::Damaged(ImageError::Decoding(DecodingError::new(ImageFormatHint::Exact(format), what)))
}
