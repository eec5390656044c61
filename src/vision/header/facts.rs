//! What the readers of the formats share.

use image::ImageFormat;

use crate::vision::error::DecodeError;

/// What the header of a file says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::vision) struct EncodedHeader {
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

/// A file's bytes, in which nothing beyond the end can be read.
#[derive(Clone, Copy)]
pub(super) struct Fields<'a>(pub &'a [u8]);

impl Fields<'_> {
    pub(super) fn at<const N: usize>(self, position: usize) -> Result<[u8; N], DecodeError> {
        let field = self.0.get(position..).and_then(|rest| rest.first_chunk());
        field.copied().ok_or(DecodeError::Truncated)
    }
}
