use super::fault::Fault;

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

    /// So many bits, at most 16, without using them; zeros follow the last one.
    pub(super) fn peek(&mut self, count: u32) -> u32 {
        self.fill();
        let window =
            if self.count < count { self.buffer << (count - self.count) } else { self.buffer >> (self.count - count) };
        u32::try_from(window & ((1 << count) - 1)).unwrap_or_default()
    }

    /// Uses bits that were peeked at.
    pub(super) fn skip(&mut self, count: u32) -> Result<(), Fault> {
        match self.count.checked_sub(count) {
            Some(left) => {
                self.count = left;
                Ok(())
            }
            // The last byte may be half of a marker.
            None if self.position + 1 >= self.bytes.len() => Err(Fault::Ends),
            None => Err("its data end early: some bytes were lost or changed".into()),
        }
    }

    /// So many bits, at most 16.
    pub(super) fn take(&mut self, count: u32) -> Result<u32, Fault> {
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
        while self.count <= 48 {
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
