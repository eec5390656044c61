use std::borrow::Cow;

use super::bits::Bits;
use super::fault::{Fault, Lost, SHORT};

/// Bits that are looked up at once; longer codes are rare.
const QUICK: u32 = 9;

/// A table of variable-length codes (T.81, annex C).
pub(super) struct Table {
    /// By the next bits: the length of the code that they start with and its symbol; a length of 0 where it is longer.
    quick: Vec<(u8, u8)>,
    /// By length less one: the first code that is longer than all of this length, in 16 places.
    limits: [u32; 16],
    /// By length less one: what makes an index of a code of this length.
    offsets: [i32; 16],
    symbols: Vec<u8>,
}

impl Table {
    /// Without any code.
    const EMPTY: Self = Self { quick: Vec::new(), limits: [0; 16], offsets: [0; 16], symbols: Vec::new() };

    /// `counts` says how many codes have each length, from 1 to 16 bits.
    fn new(counts: [u8; 16], symbols: &[u8]) -> Result<Self, Fault> {
        let (mut code, mut index) = (0_u32, 0_i32);
        let (mut limits, mut offsets) = ([0; 16], [0; 16]);
        let mut quick = vec![(0, 0); 1 << QUICK];
        for (length, count) in (1_u32..).zip(counts) {
            let at = length as usize - 1;
            offsets[at] = index - i32::try_from(code).unwrap_or(0);
            for symbol in symbols.iter().skip(usize::try_from(index).unwrap_or(0)).take(count.into()) {
                if length <= QUICK {
                    let first = (code << (QUICK - length)) as usize;
                    let entries = quick.get_mut(first..first + (1 << (QUICK - length))).ok_or(IMPOSSIBLE)?;
                    entries.fill((length.to_le_bytes()[0], *symbol));
                }
                code += 1;
                index += 1;
            }
            if code > 1 << length {
                return Err(IMPOSSIBLE);
            }
            limits[at] = code << (16 - length);
            code <<= 1;
        }
        Ok(Self { quick, limits, offsets, symbols: symbols.to_vec() })
    }

    #[inline]
    pub(super) fn symbol(&self, bits: &mut Bits<'_>) -> Result<u8, Lost> {
        let next = bits.peek(16);
        let (length, symbol) = self.quick.get((next >> (16 - QUICK)) as usize).copied().unwrap_or_default();
        if length > 0 {
            bits.skip(length.into())?;
            return Ok(symbol);
        }
        self.long_symbol(next, bits)
    }

    fn long_symbol(&self, next: u32, bits: &mut Bits<'_>) -> Result<u8, Lost> {
        for (length, (limit, offset)) in (1_u32..).zip(self.limits.iter().zip(self.offsets)) {
            if next < *limit {
                bits.skip(length)?;
                let code = i32::try_from(next >> (16 - length)).unwrap_or(0);
                let symbol = usize::try_from(code + offset).ok().and_then(|index| self.symbols.get(index));
                return symbol.copied().ok_or(Lost::Code);
            }
        }
        // With too few bits left the zeros behind them may look like no code.
        bits.skip(16)?;
        Err(Lost::Code)
    }
}

const IMPOSSIBLE: Fault = Fault::Damaged(Cow::Borrowed("its table of codes is impossible"));

/// The segment that defines the typical tables (T.81, annex K.3), for luminance and for chrominance.
pub(super) const TYPICAL: &[u8] = include_bytes!("typical.dht");

/// The tables that a scan may name, of DC and AC coefficients. Until a file defines one it is the typical one: frames of a
/// motion JPEG leave them out.
pub(super) struct Tables {
    dc: [Table; 4],
    ac: [Table; 4],
}

impl Tables {
    /// Those of motion JPEG.
    pub(super) fn typical() -> Result<Self, Fault> {
        let empty = || [const { Table::EMPTY }; 4];
        let mut tables = Self { dc: empty(), ac: empty() };
        tables.define(TYPICAL)?;
        Ok(tables)
    }

    /// From a segment that defines tables.
    pub(super) fn define(&mut self, mut segment: &[u8]) -> Result<(), Fault> {
        while let [place, rest @ ..] = segment {
            let counts: [u8; 16] = *rest.first_chunk().ok_or(SHORT)?;
            let end = 16 + counts.iter().map(|count| usize::from(*count)).sum::<usize>();
            let table = Table::new(counts, rest.get(16..end).ok_or(SHORT)?)?;
            let tables = match place >> 4 {
                0 => &mut self.dc,
                1 => &mut self.ac,
                _ => return Err(IMPOSSIBLE),
            };
            *tables.get_mut(usize::from(place & 15)).ok_or(IMPOSSIBLE)? = table;
            segment = &rest[end..];
        }
        Ok(())
    }

    pub(super) fn dc(&self, index: usize) -> &Table {
        &self.dc[index & 3]
    }

    pub(super) fn ac(&self, index: usize) -> &Table {
        &self.ac[index & 3]
    }
}
