//! Whether a JPEG is whole. Decoders that are fast fill what is missing with whatever comes out and report success: a frame
//! that lost a packet then costs a detection, or worse, moves one, in silence. Here every code of every scan is read and
//! every block counted, as ITU-T T.81 has it, without computing a pixel.

mod bits;
mod block;
mod fault;
mod frame;
mod huffman;
mod scan;

use std::borrow::Cow;

use image::metadata::Orientation;

pub(super) use fault::Fault;
use fault::SHORT;
use frame::{Frame, QuantisationSteps};
use huffman::{TYPICAL, Tables};
use scan::Scan;

/// More scans than this are an attack: each costs a pass over all blocks, and states in a few bytes that none changes.
const MAX_SCANS: usize = 100;

/// A JPEG that decoders can be given. Frames of a motion JPEG leave out their tables of codes, which are then added.
///
/// # Errors
/// What is missing from its pixels, or too much.
pub(super) fn whole(bytes: &[u8]) -> Result<Cow<'_, [u8]>, Fault> {
    if check(bytes)?.has_tables {
        return Ok(Cow::Borrowed(bytes));
    }
    let (start, rest) = bytes.split_at(2);
    let length = u16::try_from(TYPICAL.len() + 2).unwrap_or_default().to_be_bytes();
    Ok(Cow::Owned([start, &[0xFF, DEFINE_TABLES], &length, TYPICAL, rest].concat()))
}

/// What is known of a JPEG that is whole.
struct Whole {
    has_tables: bool,
}

/// Reads a JPEG from its first marker to its end marker. What comes behind that is no concern of its pixels: phones put a
/// video there.
fn check(bytes: &[u8]) -> Result<Whole, Fault> {
    let mut segments = Segments { bytes, position: 2 };
    let (mut tables, mut steps, mut frame) = (Tables::typical()?, QuantisationSteps::default(), None::<Frame>);
    let (mut restart_interval, mut scans, mut has_tables, mut turned) = (0, 0, false, None);
    loop {
        let marker = segments.marker()?;
        match marker {
            END_OF_IMAGE => {
                return match &frame {
                    Some(frame) if frame.is_complete() => Ok(Whole { has_tables }),
                    _ => Err("it ends before all of its components were stored".into()),
                };
            }
            0x01 | 0xD0..=0xD8 => return Err(format!("marker {marker:#04x} stands where a segment should").into()),
            _ => {}
        }
        let segment = segments.segment()?;
        match marker {
            0xC0..=0xC2 if frame.is_some() => return Err("it states its size twice".into()),
            0xC0..=0xC2 => frame = Some(Frame::read(segment, marker == 0xC2)?),
            DEFINE_TABLES => {
                has_tables = true;
                tables.define(segment)?;
            }
            0xDB => steps.define(segment)?,
            0xE1 => {
                let Some(exif) = segment.strip_prefix(b"Exif\0\0") else { continue };
                // Of several blocks one reader takes the first, another the last.
                let now = Orientation::from_exif_chunk(exif).unwrap_or(Orientation::NoTransforms);
                if turned.replace(now).is_some_and(|before| before != now) {
                    return Err("its EXIF blocks state different orientations".into());
                }
            }
            0xDD => restart_interval = u16::from_be_bytes(*segment.first_chunk().ok_or(SHORT)?).into(),
            0xDA => {
                scans += 1;
                if scans > MAX_SCANS {
                    return Err(format!("it has more than {MAX_SCANS} scans").into());
                }
                let frame = frame.as_mut().ok_or("its pixels come before their size")?;
                let scan = Scan::read(segment, frame, &steps)?;
                segments.position = scan.check(bytes, segments.position, frame, &tables, restart_interval)?;
            }
            _ => {}
        }
    }
}

const END_OF_IMAGE: u8 = 0xD9;
const DEFINE_TABLES: u8 = 0xC4;

/// Cameras leave a few zeros between a scan and the next marker; more, or other bytes, are part of a picture.
const MAX_STRAY_ZEROS: usize = 16;

struct Segments<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Segments<'a> {
    /// The next marker; the position is then behind it.
    fn marker(&mut self) -> Result<u8, Fault> {
        for stray in 0.. {
            let rest = self.bytes.get(self.position..).unwrap_or_default();
            match rest {
                [0xFF, marker, ..] if !matches!(marker, 0 | 0xFF) => {
                    self.position += 2;
                    return Ok(*marker);
                }
                // As many of these as one likes may stand before a marker.
                [0xFF, 0xFF, ..] => self.position += 1,
                [0, _, ..] if stray < MAX_STRAY_ZEROS => self.position += 1,
                [_, _, ..] => return Err("more bytes follow than its size asks for: some were lost or changed".into()),
                [] | [_] => return Err(Fault::Ends),
            }
        }
        Err(Fault::Ends)
    }

    /// The rest of the segment after its marker; the position is then behind it.
    fn segment(&mut self) -> Result<&'a [u8], Fault> {
        let rest = self.bytes.get(self.position..).unwrap_or_default();
        let length = usize::from(u16::from_be_bytes(*rest.first_chunk().ok_or(Fault::Ends)?));
        let segment = rest.get(2..length).ok_or(if length < 2 { SHORT } else { Fault::Ends })?;
        self.position += length;
        Ok(segment)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "shares of a file")]

    use super::*;

    fn sample() -> Vec<u8> {
        std::fs::read("samples/sample-1.jpg").unwrap()
    }

    #[test]
    fn a_whole_picture_passes_whatever_comes_behind_it() {
        let mut bytes = sample();
        assert!(check(&bytes).is_ok());
        bytes.extend(b"ftypmp42 \xFF\xDA\0\0 a video");
        assert!(check(&bytes).is_ok());
    }

    #[test]
    fn a_few_bytes_before_the_end_marker_are_a_cameras_habit() {
        let whole = sample();
        let end = whole.len() - 2;
        for (stray, passes) in [(vec![0; 4], true), (vec![0; 400], false), (vec![0x5A; 4], false)] {
            let bytes = [&whole[..end], &stray, &whole[end..]].concat();
            assert_eq!(check(&bytes).is_ok(), passes, "{stray:?}");
        }
    }

    /// Nothing in such a file is damaged: its last scans, which hold the fine detail, are simply not there.
    #[test]
    fn a_progressive_picture_without_its_last_scans_is_not_whole() {
        let whole = std::fs::read("tests/data/encodings/progressive.jpg").unwrap();
        assert!(check(&whole).is_ok());
        let scans: Vec<usize> =
            whole.windows(2).enumerate().filter(|(_, two)| *two == [0xFF, 0xDA]).map(|(at, _)| at).collect();
        for at in &scans[1..] {
            assert!(check(&[&whole[..*at], &[0xFF, 0xD9]].concat()).is_err(), "cut at {at}");
        }
        assert!(check(&[&whole[..scans[0]], &whole[scans[1]..]].concat()).is_err(), "without its first scan");
    }

    /// What is left of a packet's surroundings may by chance be as many blocks as there were: the rest of the picture is then
    /// where it was.
    #[test]
    fn a_lost_packet_is_noticed_but_for_chance() {
        let whole = sample();
        let start_of_scan = whole.windows(2).position(|two| two == [0xFF, 0xDA]).unwrap();
        for (lost, chance) in [(64, 0.15), (188, 0.05), (1400, 0.0)] {
            let places: Vec<usize> = (start_of_scan + 14..whole.len() - lost - 2).step_by(307).collect();
            let missed = places.iter().filter(|at| check(&[&whole[..**at], &whole[*at + lost..]].concat()).is_ok());
            assert!(missed.count() as f64 <= chance * places.len() as f64, "{lost} bytes");
        }
    }

    #[test]
    fn a_cut_picture_with_an_end_marker_is_not_whole() {
        let whole = sample();
        for share in [0.45, 0.9, 0.99] {
            let cut = [&whole[..(share * whole.len() as f64) as usize], &[0xFF, 0xD9]].concat();
            assert!(check(&cut).is_err(), "{share}");
        }
    }

    #[test]
    fn no_bytes_crash_it() {
        let whole = sample();
        for at in (2..700).chain((700..whole.len()).step_by(1009)) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x15;
            let _ = check(&bytes);
            let _ = check(&whole[..at]);
        }
    }
}
