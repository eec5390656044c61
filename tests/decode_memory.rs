//! Decoding keeps to what the header promises, and reading the header takes next to nothing.
#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "a test fails by panicking; small images")]

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageFormat, RgbImage};
use posed::vision::{DecodeError, DecodeOptions, Header, Image, OrientationPolicy, RawImage, decode, header};

/// The header, and the most bytes that were allocated at once while the image was decoded, or refused.
fn measured(image: &Image, options: &DecodeOptions) -> (Result<Header, DecodeError>, u64, bool) {
    let mut stated = None;
    let reading = allocation_counter::measure(|| stated = Some(header(image, options)));
    assert!(reading.bytes_max < 1024, "{} bytes for a header", reading.bytes_max);
    let mut decoded = false;
    let decoding = allocation_counter::measure(|| decoded = decode(image, options).is_ok());
    (stated.unwrap(), decoding.bytes_max, decoded)
}

/// Decodes, once as it is stored and once with leave to turn it; the share of the promise that is used at most.
fn share_used(name: &str, bytes: Vec<u8>) -> f64 {
    let image = Image::Encoded(bytes.into());
    let shares = [OrientationPolicy::Ignore, OrientationPolicy::Apply].map(|exif_orientation| {
        let (stated, peak, decoded) = measured(&image, &DecodeOptions { exif_orientation, ..DecodeOptions::default() });
        let stated = stated.unwrap();
        assert!(decoded, "{name}");
        assert_eq!(stated.rgb_bytes, 3 * u64::from(stated.width) * u64::from(stated.height));
        assert!(peak >= stated.rgb_bytes && peak <= stated.decode_bytes, "{name}: {peak} of {stated:?}");
        peak as f64 / stated.decode_bytes as f64
    });
    shares[0].max(shares[1])
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn smooth(width: u32, height: u32) -> DynamicImage {
    RgbImage::from_fn(width, height, |x, y| image::Rgb([x / 4, y / 4, (x + y) / 9].map(|v| v as u8))).into()
}

#[test]
fn every_kind_of_pixels_keeps_to_its_promise() {
    for (width, height) in [(640, 480), (1000, 800), (33, 1999)] {
        let rgb = smooth(width, height);
        let kinds = [
            ("rgb8", rgb.clone()),
            ("rgba8", rgb.to_rgba8().into()),
            ("grey8", rgb.to_luma8().into()),
            ("greya8", rgb.to_luma_alpha8().into()),
            ("rgb16", rgb.to_rgb16().into()),
            ("rgba16", rgb.to_rgba16().into()),
            ("grey16", rgb.to_luma16().into()),
        ];
        for (kind, image) in &kinds {
            share_used(&format!("PNG {kind}"), encoded(image, ImageFormat::Png));
        }
        for (kind, image) in [&kinds[0], &kinds[2]] {
            share_used(&format!("JPEG {kind}"), encoded(image, ImageFormat::Jpeg));
        }
        for (kind, image) in &kinds[..2] {
            share_used(&format!("WebP {kind}"), encoded(image, ImageFormat::WebP));
        }
    }
}

/// What the encoders of the `image` crate do not make; Pillow made these.
#[test]
fn every_kind_of_file_keeps_to_its_promise() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/encodings");
    let mut files = 0;
    for file in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let share = share_used(&file.display().to_string(), fs::read(&file).unwrap());
        // A promise of much more would be of no use; small lossy WebPs use least, for they might claim 16 MiB.
        assert!(share > 0.05, "{}: {share}", file.display());
        files += 1;
    }
    assert_eq!(files, 7);
}

#[test]
fn raw_images_take_their_result() {
    let raw = RawImage::new("bayer_rggb8:640x480".parse().unwrap(), vec![7; 640 * 480].into()).unwrap();
    let (stated, peak, _) = measured(&Image::Raw(raw), &DecodeOptions::default());
    assert_eq!((stated.unwrap().decode_bytes, peak), (3 * 640 * 480, 3 * 640 * 480));
    let small = RawImage::new("mono8:8x64".parse().unwrap(), vec![7; 8 * 64].into()).unwrap();
    assert!(matches!(
        header(&Image::Raw(small), &DecodeOptions::default()),
        Err(DecodeError::TooSmall { width: 8, .. })
    ));
}

/// Bits from the least significant one on, as lossless WebP has them.
#[derive(Default)]
struct Bits(Vec<bool>);

impl Bits {
    fn push(&mut self, value: u32, count: u32) {
        self.0.extend((0..count).map(|bit| value >> bit & 1 == 1));
    }

    fn into_bytes(self) -> Vec<u8> {
        self.0.chunks(8).map(|bits| bits.iter().rev().fold(0, |byte, bit| 2 * byte + u8::from(*bit))).collect()
    }
}

fn chunk(name: &str, data: &[u8]) -> Vec<u8> {
    [name.as_bytes(), &(data.len() as u32).to_le_bytes()[..], data, &vec![0; data.len() % 2]].concat()
}

fn webp(chunks: &[u8]) -> Image {
    Image::Encoded([b"RIFF", &(chunks.len() as u32 + 4).to_le_bytes()[..], b"WEBP", chunks].concat().into())
}

/// A 64x64 image that states 256 groups of 5 code tables of 4 kB each, with some 100 bits for each.
#[test]
fn tables_are_part_of_the_promise() {
    let mut bits = Bits::default();
    for (value, count) in [(0x2F, 8), (63, 14), (63, 14), (0, 4)] {
        bits.push(value, count);
    }
    // No transforms, no colour cache; groups for blocks of 4x4 pixels, all of them number 255 (in green).
    for (value, count) in [(0, 1), (0, 1), (1, 1), (0, 3), (0, 1)] {
        bits.push(value, count);
    }
    for symbol in [255, 0, 0, 0, 0] {
        for (value, count) in [(1, 1), (0, 1), (1, 1), (symbol, 8)] {
            bits.push(value, count);
        }
    }
    for _ in 0..5 * 256 {
        // Lengths of 1 to 10 bits, in codes of 3 bits (of lengths 1 to 6) and 4 (of lengths 7 to 10).
        bits.push(0, 1);
        bits.push(10, 4);
        for length in [0, 0, 0, 3, 3, 3, 3, 3, 0, 3, 4, 4, 4, 4] {
            bits.push(length, 3);
        }
        // Eleven symbols: 1, 2, .. 10, 10.
        for (value, count) in [(1, 1), (1, 3), (9, 4)] {
            bits.push(value, count);
        }
        for length in (1_u32..=10).chain([10]) {
            let (code, size) = if length <= 6 { (length - 1, 3) } else { (12 + length - 7, 4) };
            bits.push(code.reverse_bits() >> (32 - size), size);
        }
    }
    let image = webp(&chunk("VP8L", &bits.into_bytes()));
    let (stated, peak, _) = measured(&image, &DecodeOptions::default());
    assert!(peak > 256 * 5 * 4096, "no tables: {peak}");
    assert!(peak <= stated.unwrap().decode_bytes);
}

/// Files that claim more than they are; all that decoders would allocate before they notice.
#[test]
fn liars_are_refused_for_little() {
    let lossy =
        |side: u16| [&[0x10, 0, 0, 0x9D, 1, 0x2A], &side.to_le_bytes()[..], &side.to_le_bytes(), &[0; 20]].concat();
    let extended = |flags: u8| chunk("VP8X", &[flags, 0, 0, 0, 63, 0, 0, 63, 0, 0]);
    let frame = |parts: &[u8]| chunk("ANMF", &[&[0; 6], &[63, 0, 0, 63, 0, 0][..], &[0; 4], parts].concat());
    let animation = chunk("ANIM", &[0; 6]);
    let alpha = chunk("ALPH", &[0; 4097]);
    let exif = [chunk("VP8 ", &lossy(64)), b"EXIF\xF0\xFF\xFF\xFF".to_vec()].concat();
    for (name, chunks) in [
        ("a larger frame", [extended(0), chunk("VP8 ", &lossy(16383))].concat()),
        (
            "a larger frame in an animation",
            [extended(2), animation.clone(), frame(&chunk("VP8 ", &lossy(16383)))].concat(),
        ),
        (
            "a larger frame after an alpha plane",
            [extended(2), animation, frame(&[alpha, chunk("HIDE", &lossy(16383))].concat())].concat(),
        ),
        ("EXIF beyond the end", [extended(8), exif].concat()),
    ] {
        let (stated, peak, decoded) = measured(&webp(&chunks), &DecodeOptions::default());
        assert!(stated.is_err() && !decoded && peak < 1024, "{name}: {stated:?}, {peak} bytes");
    }
}
