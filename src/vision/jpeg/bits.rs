use super::fault::{Fault, Lost};

/// The entropy-coded data of a scan, up to the next marker.
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    /// Of the next byte that was not taken yet.
    position: usize,
    /// Bits that were taken and not used yet, in the lowest places.
    buffer: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    pub(super) fn new(bytes: &'a [u8], position: usize) -> Self {
        Self { bytes, position, buffer: 0, count: 0 }
    }

    #[expect(clippy::cast_possible_truncation, reason = "the lowest bits")]
    /// So many bits, at most 16, without using them; zeros follow the last one.
    #[inline]
    pub(super) fn peek(&mut self, count: u32) -> u32 {
        if self.count < READY {
            self.fill();
        }
        let window =
            if self.count < count { self.buffer << (count - self.count) } else { self.buffer >> (self.count - count) };
        window as u32 & ((1 << count) - 1)
    }

    /// Uses bits that were peeked at.
    #[inline]
    pub(super) fn skip(&mut self, count: u32) -> Result<(), Lost> {
        match self.count.checked_sub(count) {
            Some(left) => {
                self.count = left;
                Ok(())
            }
            // The last byte may be half of a marker.
            None if self.position + 1 >= self.bytes.len() => Err(Lost::FileEnds),
            None => Err(Lost::DataEnd),
        }
    }

    /// So many bits, at most 16.
    #[inline]
    pub(super) fn take(&mut self, count: u32) -> Result<u32, Lost> {
        let value = self.peek(count);
        self.skip(count)?;
        Ok(value)
    }

    /// Leaves out the rest of a byte, and a restart marker, which must be this one.
    pub(super) fn restart(&mut self, marker: u8) -> Result<(), Fault> {
        let at = self.end();
        match self.bytes.get(at..at + 2) {
            Some([0xFF, found]) if *found == marker => {
                *self = Self::new(self.bytes, at + 2);
                Ok(())
            }
            _ => Err("a restart marker is missing: some bytes were lost or changed".into()),
        }
    }

    /// Where the first byte is of which nothing was used.
    pub(super) fn end(&self) -> usize {
        let mut position = self.position;
        for _ in 0..self.count / 8 {
            // The zero after a byte of ones is part of it.
            position -= if position >= 2 && self.bytes.get(position - 2..position) == Some(&[0xFF, 0]) { 2 } else { 1 };
        }
        position
    }

    fn fill(&mut self) {
        let rest = self.bytes.get(self.position..).unwrap_or_default();
        // Four at once where none of them can be a marker, or stuffed.
        if let Some(four) = rest.first_chunk::<4>().filter(|four| !four.contains(&0xFF)) {
            self.buffer = self.buffer << 32 | u64::from(u32::from_be_bytes(*four));
            self.position += 4;
            self.count += 32;
            return;
        }
        while self.count < READY {
            let taken = match self.bytes.get(self.position..) {
                Some([0xFF, 0, ..]) => 2,
                Some([0xFF, ..] | []) | None => return,
                Some([_, ..]) => 1,
            };
            self.buffer = self.buffer << 8 | u64::from(self.bytes[self.position]);
            self.position += taken;
            self.count += 8;
        }
    }
}

/// With as many bits at hand a code and the value after it need no more.
const READY: u32 = 32;
