use super::bits::Bits;
use super::block::{Progressive, dc_first, sequential};
use super::fault::{Fault, Lost, SHORT};
use super::frame::{Component, Frame, QuantisationSteps};
use super::huffman::Tables;

/// A pass over some components, of a progressive picture over some of their coefficients (T.81, B.2.3).
pub(super) struct Scan {
    parts: Vec<Part>,
    /// First and last coefficient, in zigzag order.
    first: u8,
    last: u8,
    /// Whether it adds a bit to coefficients of earlier scans.
    refines: bool,
    /// How many bits of its coefficients later scans add.
    missing_bits: u8,
}

/// A component of the frame and its tables.
struct Part {
    component: usize,
    dc: usize,
    ac: usize,
}

impl Scan {
    pub(super) fn read(segment: &[u8], frame: &mut Frame, steps: &QuantisationSteps) -> Result<Self, Fault> {
        let (count, rest) = segment.split_first().ok_or(SHORT)?;
        let count = usize::from(*count);
        let stated = rest.get(..2 * count).ok_or(SHORT)?;
        let [first, last, approximation] = *rest[2 * count..].first_chunk().ok_or(SHORT)?;
        let part = |stated: &[u8]| {
            let component = frame.components.iter().position(|component| component.id == stated[0]);
            let component = component.ok_or("a scan is about a component that it does not have")?;
            Ok(Part { component, dc: usize::from(stated[1] >> 4), ac: usize::from(stated[1] & 15) })
        };
        let parts: Vec<Part> = stated.chunks_exact(2).map(part).collect::<Result<_, Fault>>()?;
        for part in &parts {
            frame.quantise(part.component, steps);
        }
        if parts.is_empty() || parts.iter().any(|part| part.dc > 3 || part.ac > 3) {
            return Err("a scan has no components or names a table that cannot be".into());
        }
        if !frame.progressive {
            if parts.len() < frame.components.len() && frame.is_subsampled() {
                return Err("its subsampled components are stored one after another, which cannot be decoded; store \
                            them interleaved, as encoders do by default"
                    .into());
            }
            return Ok(Self { parts, first: 0, last: 63, refines: false, missing_bits: 0 });
        }
        let possible = first <= last && last <= 63 && (first == 0) == (last == 0) && (first == 0 || count == 1);
        if !possible {
            return Err(format!("a scan is about coefficients {first} to {last} of {count} components").into());
        }
        let band = usize::from(first)..=usize::from(last);
        let before = approximation >> 4;
        let unknown = |part: &Part| {
            frame.components[part.component].missing_bits[band.clone()].iter().any(|bits| *bits != before)
        };
        if before > 0 && parts.iter().any(unknown) {
            return Err("a scan refines coefficients that no scan before it has".into());
        }
        Ok(Self { parts, first, last, refines: approximation >> 4 > 0, missing_bits: approximation & 15 })
    }

    /// Reads its data, which start at this position, and says where they end.
    pub(super) fn check(
        &self,
        bytes: &[u8],
        position: usize,
        frame: &mut Frame,
        tables: &Tables,
        restart_interval: usize,
    ) -> Result<usize, Fault> {
        let alone = self.parts.len() == 1;
        let units = if alone { frame.components[self.parts[0].component].blocks } else { frame.units() };
        let mut reader = Reader {
            scan: self,
            bits: Bits::new(bytes, position),
            tables,
            before: [0; 4],
            progressive: Progressive {
                table: tables.ac(self.parts[0].ac),
                first: self.first,
                last: self.last,
                refines: self.refines,
                empty_blocks: 0,
            },
        };
        let mut restarts = (0xD0..=0xD7).cycle();
        for unit in 0..units {
            if restart_interval > 0 && unit > 0 && unit % restart_interval == 0 {
                reader.finish_interval()?;
                reader.bits.restart(restarts.next().unwrap_or_default())?;
                reader.before = [0; 4];
            }
            for (index, part) in self.parts.iter().enumerate() {
                let component = &mut frame.components[part.component];
                let blocks = if alone { 1 } else { component.across * component.down };
                for _ in 0..blocks {
                    reader.block(index, part, component, unit, frame.progressive)?;
                }
            }
        }
        reader.finish_interval()?;
        for part in &self.parts {
            let missing = &mut frame.components[part.component].missing_bits;
            missing[usize::from(self.first)..=usize::from(self.last)].fill(self.missing_bits);
        }
        Ok(reader.bits.end())
    }
}

/// The state of a scan between two blocks.
struct Reader<'a> {
    scan: &'a Scan,
    bits: Bits<'a>,
    tables: &'a Tables,
    /// The DC coefficient of each part's last block.
    before: [i32; 4],
    progressive: Progressive<'a>,
}

impl Reader<'_> {
    fn block(
        &mut self,
        index: usize,
        part: &Part,
        component: &mut Component,
        unit: usize,
        progressive: bool,
    ) -> Result<(), Lost> {
        if self.scan.first > 0 {
            return self.progressive.block(&mut self.bits, &mut component.nonzero[unit]);
        }
        if self.scan.refines {
            return self.bits.take(1).map(|_| ());
        }
        dc_first(&mut self.bits, self.tables.dc(part.dc), &mut self.before[index & 3], component.ranges[0].into())?;
        if progressive { Ok(()) } else { sequential(&mut self.bits, self.tables.ac(part.ac), &component.ranges) }
    }

    fn finish_interval(&mut self) -> Result<(), Fault> {
        match std::mem::take(&mut self.progressive.empty_blocks) {
            0 => Ok(()),
            _ => Err("more blocks follow than it has: some bytes were lost or changed".into()),
        }
    }
}
