use thiserror::Error;

use super::encoding::RawEncoding;

/// A raw image that does not fit its layout.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RawError {
    #[error("unknown encoding {0:?}; known encodings: {known}", known = RawEncoding::ALL.map(RawEncoding::name).join(", "))]
    UnknownEncoding(String),
    #[error("{0:?} is not a raw layout; write ENCODING:WIDTHxHEIGHT[:STEP], for example bgr8:1280x720")]
    Layout(String),
    #[error("the raw frame is {width}x{height}; 'width' and 'height' must be at least 1")]
    Empty { width: u32, height: u32 },
    #[error(
        "the raw frame is {width}x{height}; {encoding} needs a 'width' that is a multiple of {cell_width} and a 'height' \
         that is a multiple of {cell_height}; post the full frame, or convert it"
    )]
    Odd { encoding: RawEncoding, width: u32, height: u32, cell_width: u32, cell_height: u32 },
    #[error(
        "'step' is {step} bytes; for {width} pixels of {encoding} it must be between {row} and {max}; omit 'step' if \
         rows have no padding",
        max = u32::MAX
    )]
    Step { step: u64, encoding: RawEncoding, width: u32, row: u64 },
    #[error(
        "the raw frame has {length} bytes; {width}x{height} pixels of {encoding} need {expected} ({rows} rows of 'step' \
         {step}); check 'width', 'height' and 'step'"
    )]
    Length { length: usize, expected: u64, encoding: RawEncoding, width: u32, height: u32, step: u32, rows: u64 },
}
