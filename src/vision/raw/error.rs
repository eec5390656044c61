use thiserror::Error;

use super::encoding::RawEncoding;

/// A raw image that does not fit its layout.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RawError {
    #[error("encoding {0:?} is not known; known are {known}", known = RawEncoding::ALL.map(RawEncoding::name).join(", "))]
    UnknownEncoding(String),
    #[error("{0:?} is not a raw layout; write ENCODING:WIDTHxHEIGHT[:STEP], for example bgr8:1280x720")]
    Layout(String),
    #[error("a raw image is {width}x{height}; 'width' and 'height' must be at least 1")]
    Empty { width: u32, height: u32 },
    #[error(
        "a raw image is {width}x{height}; {encoding} needs a 'width' that is a multiple of {cell_width} and a 'height' that \
         is a multiple of {cell_height}: its pixels share their colours; post the whole frame of the sensor, or convert it"
    )]
    Odd { encoding: RawEncoding, width: u32, height: u32, cell_width: u32, cell_height: u32 },
    #[error(
        "'step' is {step} bytes; a row of {width} pixels of {encoding} takes {row}, and at most {max} are possible; \
         leave 'step' out where rows have no padding",
        max = u32::MAX
    )]
    Step { step: u64, encoding: RawEncoding, width: u32, row: u64 },
    #[error(
        "'data' is {length} bytes; {width}x{height} pixels of {encoding} take {expected} ({rows} rows of 'step' {step}); \
         check 'width', 'height' and 'step'"
    )]
    Length { length: usize, expected: u64, encoding: RawEncoding, width: u32, height: u32, step: u32, rows: u64 },
}
