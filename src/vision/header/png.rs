use image::ImageFormat;

use super::facts::{EncodedHeader, Fields};
use crate::vision::error::{DecodeError, damaged};

/// The decoder's window, buffers and smallest tables: 150 kB and 300 kB measured.
const BUFFERS: u64 = 512 << 10;

/// Rows in work, for each pixel of width: 48 measured.
const ROWS: u64 = 160;

/// For each byte of text, EXIF and profiles: copies, growing buffers, and a record for each chunk, which may be shorter than
/// its record.
const METADATA: u64 = 40;

/// What the decoder may count for metadata and a row of pixels: enough for all that is stored plainly. It leaves out a colour
/// profile that grows beyond that when it is inflated; nothing here needs profiles.
const LIMIT: u64 = 3;
const LIMIT_ROW: u64 = 16;
const LIMIT_LEAST: u64 = 64 << 10;

pub(super) fn read(bytes: &[u8]) -> Result<EncodedHeader, DecodeError> {
    let fields = Fields(bytes);
    if fields.at(8)? != *b"\0\0\0\x0DIHDR" {
        return Err(damaged(ImageFormat::Png, "it does not start with its header"));
    }
    let (width, height) = (u32::from_be_bytes(fields.at(16)?), u32::from_be_bytes(fields.at(20)?));
    let [depth, colour] = fields.at(24)?;
    let (transparent, metadata) = chunks(fields)?;
    let channels = match colour {
        0 => 1 + u64::from(transparent),
        2 | 3 => 3 + u64::from(transparent),
        4 => 2,
        // 6, or nothing that the decoder knows.
        _ => 4,
    };
    Ok(EncodedHeader {
        format: ImageFormat::Png,
        width,
        height,
        output: channels * if depth == 16 { 2 } else { 1 },
        working: BUFFERS + ROWS * u64::from(width) + METADATA * metadata,
        metadata: LIMIT_LEAST + LIMIT_ROW * u64::from(width) + LIMIT * metadata,
    })
}

/// Whether a colour stands for transparency, and how many bytes of metadata there are, before the pixels.
fn chunks(fields: Fields<'_>) -> Result<(bool, u64), DecodeError> {
    let (mut position, mut transparent, mut metadata) = (8_usize, false, 0);
    loop {
        let length = u32::from_be_bytes(fields.at(position)?);
        match &fields.at::<4>(position + 4)? {
            b"IDAT" => return Ok((transparent, metadata)),
            b"acTL" => return Err(DecodeError::Animated),
            b"tRNS" => transparent = true,
            b"eXIf" | b"iCCP" | b"iTXt" | b"tEXt" | b"zTXt" => metadata += u64::from(length) + 12,
            _ => {}
        }
        position = position.saturating_add(length as usize).saturating_add(12);
    }
}
