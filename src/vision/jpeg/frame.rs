use super::block::{Ranges, range};
use super::fault::{Fault, SHORT};

/// What a picture is made of (T.81, B.2.2).
pub(super) struct Frame {
    pub progressive: bool,
    width: usize,
    height: usize,
    pub components: Vec<Component>,
}

pub(super) struct Component {
    pub id: u8,
    /// Which table of quantisation steps its coefficients were divided by.
    steps: u8,
    /// Valid once its first scan begins: tables may come until then.
    pub ranges: Ranges,
    /// Blocks of a unit, across and down, where a scan holds several components.
    pub across: usize,
    pub down: usize,
    /// Blocks that the picture needs, and not those that only fill units up.
    pub blocks: usize,
    /// Of a progressive picture: for each block, which of its coefficients are known not to be zero.
    pub nonzero: Vec<u64>,
    /// Of each coefficient, in zigzag order, how many bits are still to come.
    pub missing_bits: [u8; 64],
}

/// A picture has one component, three or four.
const MAX_COMPONENTS: usize = 4;
/// A side of a block.
const BLOCK: usize = 8;

impl Frame {
    pub(super) fn read(segment: &[u8], progressive: bool) -> Result<Self, Fault> {
        let [precision, height_high, height_low, width_high, width_low, count] = *segment.first_chunk().ok_or(SHORT)?;
        if precision != 8 {
            return Err(format!("it has {precision} bits a sample; only 8 can be decoded").into());
        }
        let width = usize::from(u16::from_be_bytes([width_high, width_low]));
        let height = usize::from(u16::from_be_bytes([height_high, height_low]));
        let count = usize::from(count);
        let stated = segment.get(6..6 + 3 * count).ok_or(SHORT)?;
        if width == 0 || height == 0 || count == 0 || count > MAX_COMPONENTS {
            return Err(format!("it is {width}x{height} with {count} components").into());
        }
        let factors: Vec<[usize; 2]> =
            stated.chunks_exact(3).map(|c| [usize::from(c[1] >> 4), usize::from(c[1] & 15)]).collect();
        if factors.iter().flatten().any(|factor| !(1..=4).contains(factor)) {
            return Err("its sampling factors are not between 1 and 4".into());
        }
        let most = |axis: usize| factors.iter().map(|factor| factor[axis]).max().unwrap_or(1);
        let (most_across, most_down) = (most(0), most(1));
        let components = stated.chunks_exact(3).zip(&factors).map(|(component, [across, down])| {
            let columns = (width * across).div_ceil(most_across).div_ceil(BLOCK);
            let rows = (height * down).div_ceil(most_down).div_ceil(BLOCK);
            let blocks = columns * rows;
            let nonzero = if progressive { vec![0; blocks] } else { Vec::new() };
            Component {
                id: component[0],
                steps: component[2],
                ranges: [u16::MAX; 64],
                across: *across,
                down: *down,
                blocks,
                nonzero,
                missing_bits: [u8::MAX; 64],
            }
        });
        let components = components.collect();
        Ok(Self { progressive, width, height, components })
    }

    /// Takes the steps of a component from tables that were defined by now.
    pub(super) fn quantise(&mut self, component: usize, steps: &QuantisationSteps) {
        let component = &mut self.components[component];
        if let Some(Some(steps)) = steps.0.get(usize::from(component.steps)) {
            component.ranges = steps.map(range);
        }
    }

    /// Units of a scan that holds several components.
    pub(super) fn units(&self) -> usize {
        let most = |factor: fn(&Component) -> usize| self.components.iter().map(factor).max().unwrap_or(1);
        let (across, down) = (most(|component| component.across), most(|component| component.down));
        self.width.div_ceil(BLOCK * across) * self.height.div_ceil(BLOCK * down)
    }

    pub(super) fn is_complete(&self) -> bool {
        self.components.iter().all(|component| component.missing_bits == [0; 64])
    }

    /// Whether components are stored with fewer pixels than others.
    pub(super) fn is_subsampled(&self) -> bool {
        let first = &self.components[0];
        self.components.iter().any(|component| (component.across, component.down) != (first.across, first.down))
    }
}

/// The tables of quantisation steps, in zigzag order (T.81, B.2.4.1).
#[derive(Default)]
pub(super) struct QuantisationSteps([Option<[u16; 64]>; 4]);

impl QuantisationSteps {
    /// From a segment that defines some.
    pub(super) fn define(&mut self, mut segment: &[u8]) -> Result<(), Fault> {
        while let [place, rest @ ..] = segment {
            let width = if place >> 4 == 0 { 1 } else { 2 };
            let stated = rest.get(..64 * width).ok_or(SHORT)?;
            let mut steps = [0; 64];
            for (step, bytes) in steps.iter_mut().zip(stated.chunks_exact(width)) {
                *step = bytes.iter().fold(0, |step, byte| step << 8 | u16::from(*byte));
            }
            let table = self.0.get_mut(usize::from(place & 15)).ok_or("it has a fifth table of quantisation steps")?;
            *table = Some(steps);
            segment = &rest[64 * width..];
        }
        Ok(())
    }
}
