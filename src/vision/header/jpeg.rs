use image::ImageFormat;

use super::facts::{EncodedHeader, Fields};
use crate::vision::error::{DecodeError, damaged};

/// For each byte of the file: the decoder's copy of it, a copy of its metadata, and a record for each of their segments,
/// which may be shorter than its record.
const FILE: u64 = 7;

/// Rows in work, for each pixel of width: 168 measured of 4:2:0; 4:1:0 of four components takes most.
const ROWS: u64 = 640;

/// Huffman tables and other small things.
const TABLES: u64 = 64 << 10;

/// Bytes of a coefficient, of frames that are kept as a whole: progressive ones, and those with a scan for each component.
const COEFFICIENT: u64 = 2;

/// The largest sides of what is decoded at once, pixels.
const UNIT: u64 = 32;

pub(super) fn read(bytes: &[u8]) -> Result<EncodedHeader, DecodeError> {
    let fields = Fields(bytes);
    // Bytes between segments, where the decoder might find another segment than is found here: then the worst is expected.
    let mut strange = false;
    let mut frame = None;
    let mut position = 2;
    loop {
        let [first, marker] = fields.at(position)?;
        if first != 0xFF || marker == 0xFF || marker == 0 {
            strange |= first != 0xFF || marker == 0;
            position += 1;
            continue;
        }
        let segment = position + 2;
        let length = usize::from(u16::from_be_bytes(fields.at(segment)?));
        match marker {
            0xC0..=0xC2 if frame.is_none() => frame = Some(StartOfFrame::read(fields, marker, segment)?),
            0xDA => {
                let frame = frame.ok_or_else(|| damaged(ImageFormat::Jpeg, "its pixels come before their size"))?;
                let [scan] = fields.at(segment + 2)?;
                return Ok(frame.demand(bytes.len() as u64, scan, strange));
            }
            0xC3 | 0xC5..=0xC7 | 0xC9..=0xCB | 0xCD..=0xCF => {
                return Err(damaged(ImageFormat::Jpeg, "only baseline and progressive JPEGs can be decoded"));
            }
            // The decoder misreads the length of this one.
            0xE0 if length == 6 => strange = true,
            _ => {}
        }
        position = segment + length.max(2);
    }
}

/// The segment that states an image's size and components.
struct StartOfFrame {
    progressive: bool,
    width: u32,
    height: u32,
    components: u8,
    /// Horizontal and vertical sampling factors; there are at most four.
    sampling: Vec<(u64, u64)>,
}

impl StartOfFrame {
    fn read(fields: Fields<'_>, marker: u8, segment: usize) -> Result<Self, DecodeError> {
        let [_, height_high, height_low, width_high, width_low, components] = fields.at(segment + 2)?;
        let factors = |index: u8| {
            let [_, factors, _] = fields.at(segment + 8 + 3 * usize::from(index))?;
            Ok((u64::from(factors >> 4).max(1), u64::from(factors & 15).max(1)))
        };
        Ok(Self {
            progressive: marker == 0xC2,
            width: u16::from_be_bytes([width_high, width_low]).into(),
            height: u16::from_be_bytes([height_high, height_low]).into(),
            components,
            sampling: (0..components.min(4)).map(factors).collect::<Result<_, DecodeError>>()?,
        })
    }

    /// `scan` is the number of components in the first scan.
    fn demand(&self, file: u64, scan: u8, strange: bool) -> EncodedHeader {
        let (width, height) = (u64::from(self.width), u64::from(self.height));
        let (padded_width, padded_height) = (width.next_multiple_of(UNIT), height.next_multiple_of(UNIT));
        let coefficients = if strange {
            4 * padded_width * padded_height
        } else if self.progressive || scan != self.components {
            let (across, down) = self.sampling.iter().fold((1, 1), |(h, v), s| (s.0.max(h), s.1.max(v)));
            let blocks: u64 = self.sampling.iter().map(|(h, v)| h * v).sum();
            64 * blocks * width.div_ceil(8 * across) * height.div_ceil(8 * down)
        } else {
            0
        };
        EncodedHeader {
            format: ImageFormat::Jpeg,
            width: self.width,
            height: self.height,
            output: if self.components == 1 { 1 } else { 3 },
            working: FILE * file + TABLES + ROWS * padded_width + COEFFICIENT * coefficients,
            metadata: 0,
        }
    }
}
