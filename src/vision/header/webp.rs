use image::ImageFormat;

use super::facts::{EncodedHeader, Fields};
use crate::vision::error::{DecodeError, damaged};

/// Bytes of each pixel that lossy decoding takes: planes of luma and chroma, and the modes of its blocks; 1.8 measured.
const LOSSY: u64 = 2;

/// With transparency: the alpha plane, which is decoded as if it were an image, and what it is taken from; 6.5 measured.
const ALPHA: u64 = 7;

/// Lossless decoding: RGBA before it becomes RGB, and transforms for each 4x4 pixels; 4.0 measured.
const LOSSLESS: u64 = 5;

/// For each byte of lossless data: it may state as many code tables as it likes, each hundreds of times as large as the bits
/// that state it. 450 times was measured, 512 is the most by the decoder's source. Honest files take next to nothing of this,
/// but nothing in their headers tells them from the others.
const TABLES: u64 = 600;

/// For each byte of the file: its parts, collected and copied.
const FILE: u64 = 4;

/// A lossy frame states the sizes of two of its parts before they are read: 16 MiB and 0.5 MiB at most.
const PARTS: u64 = 17 << 20;

/// Rows in work, for each pixel of width, and other small things.
const ROWS: u64 = 64;
const BUFFERS: u64 = 256 << 10;

/// Blocks of lossy frames have this side, pixels.
const BLOCK: u64 = 16;

pub(super) fn read(bytes: &[u8]) -> Result<EncodedHeader, DecodeError> {
    let fields = Fields(bytes);
    let mut found = Found::default();
    let first = Chunk::read(fields, 12)?;
    let (width, height) = match &first.name {
        b"VP8 " => lossy_size(fields, first.start)?.ok_or_else(|| wrong("its frame has no size"))?,
        b"VP8L" => {
            let [_, a, b, c, d] = fields.at(first.start)?;
            let sizes = u32::from_le_bytes([a, b, c, d]);
            found.alpha = sizes >> 28 & 1 != 0;
            ((sizes & 0x3FFF) + 1, (sizes >> 14 & 0x3FFF) + 1)
        }
        b"VP8X" => {
            let [flags, _, _, _, w0, w1, w2, h0, h1, h2] = fields.at(first.start)?;
            found.alpha = flags & 0x10 != 0;
            if flags & 0x02 != 0 {
                return Err(DecodeError::Animated);
            }
            (u32::from_le_bytes([w0, w1, w2, 0]) + 1, u32::from_le_bytes([h0, h1, h2, 0]) + 1)
        }
        _ => return Err(wrong("it does not start with its header")),
    };
    if found.alpha {
        found.takes(ALPHA);
    }
    if &first.name == b"VP8X" {
        let file = u32::from_le_bytes(fields.at(4)?) as usize;
        let mut position = first.next();
        let end = position.saturating_add(file.saturating_sub(12)).min(bytes.len().saturating_sub(7));
        while position < end {
            let chunk = Chunk::read(fields, position)?;
            found.add(fields, &chunk, (width, height))?;
            position = chunk.next();
        }
    } else {
        found.add(fields, &first, (width, height))?;
    }
    Ok(found.demand(width, height, bytes.len() as u64))
}

/// What of a file matters for its memory.
#[derive(Default)]
struct Found {
    alpha: bool,
    /// Bytes for each pixel beside the output.
    for_each_pixel: u64,
    /// Bytes for parts that a frame may claim.
    parts: u64,
    /// Bytes that may state code tables.
    tables: u64,
}

impl Found {
    fn add(&mut self, fields: Fields<'_>, chunk: &Chunk, canvas: (u32, u32)) -> Result<(), DecodeError> {
        match &chunk.name {
            b"VP8 " => self.add_lossy(fields, chunk, canvas)?,
            b"VP8L" => {
                self.takes(LOSSLESS);
                self.tables += chunk.size as u64;
            }
            b"ALPH" => self.tables += chunk.size as u64,
            b"ANMF" => return Err(DecodeError::Animated),
            _ => {}
        }
        Ok(())
    }

    /// The decoder allocates what a frame states before it compares that with the image's size.
    fn add_lossy(&mut self, fields: Fields<'_>, chunk: &Chunk, canvas: (u32, u32)) -> Result<(), DecodeError> {
        self.takes(LOSSY);
        self.parts = PARTS;
        match lossy_size(fields, chunk.start)? {
            Some((width, height)) if width > canvas.0 || height > canvas.1 => {
                Err(wrong("a frame is larger than the image"))
            }
            Some(_) | None => Ok(()),
        }
    }

    fn takes(&mut self, for_each_pixel: u64) {
        self.for_each_pixel = self.for_each_pixel.max(for_each_pixel);
    }

    fn demand(&self, width: u32, height: u32, file: u64) -> EncodedHeader {
        let padded = u64::from(width).next_multiple_of(BLOCK) * u64::from(height).next_multiple_of(BLOCK);
        let rows = ROWS * u64::from(width) + BUFFERS;
        EncodedHeader {
            format: ImageFormat::WebP,
            width,
            height,
            output: if self.alpha { 4 } else { 3 },
            working: self.for_each_pixel * padded + TABLES * self.tables + FILE * file + self.parts + rows,
            metadata: 0,
        }
    }
}

struct Chunk {
    name: [u8; 4],
    start: usize,
    size: usize,
}

impl Chunk {
    /// One that lies within the file: the decoder allocates what it states.
    fn read(fields: Fields<'_>, position: usize) -> Result<Self, DecodeError> {
        let name = fields.at(position)?;
        let size = u32::from_le_bytes(fields.at(position.saturating_add(4))?) as usize;
        let start = position.saturating_add(8);
        if start.saturating_add(size) > fields.0.len() {
            return Err(DecodeError::Truncated);
        }
        Ok(Self { name, start, size })
    }

    /// Where the next one starts; sizes are padded to even ones.
    fn next(&self) -> usize {
        self.start + self.size.next_multiple_of(2)
    }
}

/// Width and height of a lossy frame; `None` where the decoder does not take it for one.
fn lossy_size(fields: Fields<'_>, start: usize) -> Result<Option<(u32, u32)>, DecodeError> {
    let [tag, _, _, a, b, c, w0, w1, h0, h1] = fields.at(start)?;
    let side = |low, high| u32::from(u16::from_le_bytes([low, high]) & 0x3FFF);
    Ok((tag & 1 == 0 && [a, b, c] == [0x9D, 0x01, 0x2A]).then(|| (side(w0, w1), side(h0, h1))))
}

fn wrong(what: &str) -> DecodeError {
    damaged(ImageFormat::WebP, what)
}
