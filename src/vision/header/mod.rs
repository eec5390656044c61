//! What an image demands, from its header alone: nothing of its size is allocated to find that out.
//!
//! Decoders trust their files, and some files lie: a few bytes may claim the largest frame, or tables hundreds of times
//! their own size. What is promised here are upper bounds for any file, read from the decoders' sources and measured on
//! images of 24 megapixels; typical files take less.

mod facts;
mod jpeg;
mod png;
mod read;
mod webp;

pub(super) use facts::EncodedHeader;
pub(super) use read::check_size;
pub use read::{Header, header};
