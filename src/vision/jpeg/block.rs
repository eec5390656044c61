use super::bits::Bits;
use super::fault::Lost;
use super::huffman::Table;

/// A code for a run of zeros, and for nothing else.
const ZERO_RUN: u8 = 0xF0;
/// No block of 8-bit samples has a larger coefficient, before it is quantised.
const MAX_COEFFICIENT: u32 = 1024;

/// The largest quantised coefficients of a block, in zigzag order, by their quantisation steps.
pub(super) type Ranges = [u16; 64];

/// What lost bytes leave is often beyond it.
pub(super) fn range(step: u16) -> u16 {
    // Encoders round, and some of them badly.
    u16::try_from(MAX_COEFFICIENT / u32::from(step.max(1)) + 2).unwrap_or(u16::MAX)
}

/// A difference of DC coefficients, added to the one before.
pub(super) fn dc_first(bits: &mut Bits<'_>, table: &Table, before: &mut i32, range: i32) -> Result<(), Lost> {
    let length = table.symbol(bits)?;
    *before += value(bits, length)?;
    if before.abs() > range { Err(Lost::Range) } else { Ok(()) }
}

/// A coefficient of so many bits (T.81, F.2.2.1).
fn value(bits: &mut Bits<'_>, length: u8) -> Result<i32, Lost> {
    if length == 0 {
        return Ok(0);
    }
    if length > MAX_BITS {
        return Err(Lost::Range);
    }
    let value = bits.take(length.into())?.cast_signed();
    let negative = value < 1 << (length - 1);
    Ok(if negative { value + 1 - (1 << length) } else { value })
}

/// The difference of the two farthest DC coefficients has so many.
const MAX_BITS: u8 = 12;

/// The AC coefficients of a block of a sequential picture.
pub(super) fn sequential(bits: &mut Bits<'_>, table: &Table, ranges: &Ranges) -> Result<(), Lost> {
    let mut k = 1_u8;
    while k < 64 {
        let symbol = table.symbol(bits)?;
        let (run, length) = (symbol >> 4, symbol & 15);
        match (symbol, length) {
            (ZERO_RUN, _) => k += 16,
            (_, 0) => return Ok(()),
            _ => {
                k += run;
                let range = *ranges.get(usize::from(k)).ok_or(Lost::Block)?;
                if value(bits, length)?.unsigned_abs() > range.into() {
                    return Err(Lost::Range);
                }
                k += 1;
            }
        }
    }
    if k == 64 { Ok(()) } else { Err(Lost::Block) }
}

/// The AC coefficients that a scan of a progressive picture adds (T.81, annex G.1.2.2 and G.1.2.3).
pub(super) struct Progressive<'a> {
    pub table: &'a Table,
    pub first: u8,
    pub last: u8,
    /// Whether it adds a bit to coefficients that are known.
    pub refines: bool,
    /// Blocks to come that have no more new coefficients.
    pub empty_blocks: u32,
}

impl Progressive<'_> {
    pub(super) fn block(&mut self, bits: &mut Bits<'_>, nonzero: &mut u64) -> Result<(), Lost> {
        let mut k = self.first;
        while self.empty_blocks == 0 && k <= self.last {
            let symbol = self.table.symbol(bits)?;
            let (run, length) = (symbol >> 4, symbol & 15);
            if length == 0 && symbol != ZERO_RUN {
                self.empty_blocks = (1 << run) + bits.take(run.into())?;
                break;
            }
            if length > 0 {
                bits.take(length.into())?;
            }
            k = self.pass(bits, k, run, *nonzero)?;
            if k > self.last {
                // A run of zeros may end with the block; a coefficient needs a place.
                return if length > 0 { Err(Lost::Block) } else { Ok(()) };
            }
            if length > 0 {
                *nonzero |= 1 << k;
            }
            k += 1;
        }
        if self.empty_blocks > 0 {
            if self.refines && k <= self.last {
                let rest = u64::MAX >> (63 - self.last) & u64::MAX << k;
                refine(bits, (*nonzero & rest).count_ones())?;
            }
            self.empty_blocks -= 1;
        }
        Ok(())
    }

    /// The place after so many zeros from here.
    fn pass(&self, bits: &mut Bits<'_>, from: u8, zeros: u8, nonzero: u64) -> Result<u8, Lost> {
        if !self.refines {
            return Ok(from + zeros);
        }
        let (mut k, mut left) = (from, zeros);
        while k <= self.last {
            if nonzero >> k & 1 == 1 {
                refine(bits, 1)?;
            } else if left == 0 {
                break;
            } else {
                left -= 1;
            }
            k += 1;
        }
        Ok(k)
    }
}

/// A bit for each coefficient that is known.
fn refine(bits: &mut Bits<'_>, count: u32) -> Result<(), Lost> {
    (0..count).try_for_each(|_| bits.take(1).map(|_| ()))
}
