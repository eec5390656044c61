use bytes::Bytes;

use super::raw::RawImage;

/// An image as it comes from outside.
#[derive(Clone, Debug)]
pub enum Image {
    /// The bytes of a JPEG, PNG or WebP.
    Encoded(Bytes),
    /// Pixels as a camera's driver gives them.
    Raw(RawImage),
}

impl Image {
    /// Bytes that it takes as it came.
    #[must_use]
    pub fn byte_count(&self) -> usize {
        match self {
            Self::Encoded(bytes) => bytes.len(),
            Self::Raw(raw) => raw.byte_count(),
        }
    }
}
