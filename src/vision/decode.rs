use std::borrow::Cow;
use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits, RgbImage};

use super::error::{DecodeError, damaged};
use super::header::{EncodedHeader, header};
use super::jpeg;
use super::options::{DecodeOptions, OrientationPolicy};
use super::source::Image;

/// An image, and what was found in its file.
#[derive(Clone, Debug)]
pub struct Decoded {
    pub image: RgbImage,
    pub exif: Exif,
}

/// How an image asks to be turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exif {
    /// 1..=8: 1 is "as stored".
    pub orientation: u8,
    /// Whether it was turned so.
    pub applied: bool,
}

/// Makes 8-bit RGB of an image, within the memory that [`header`](super::header) promises.
///
/// Grey becomes RGB, alpha is dropped, 16 bits are reduced to 8, from the 8, 10, 12, 14 or 16 of them that are used. Sizes are checked on the header, before the pixels are
/// allocated. An EXIF orientation other than "as stored" is treated as the options say.
///
/// # Errors
/// [`DecodeError`] says what is wrong with the bytes and which limit they break.
pub fn decode(image: &Image, options: &DecodeOptions) -> Result<Decoded, DecodeError> {
    match image {
        Image::Encoded(bytes) => decode_file(bytes, options),
        Image::Raw(raw) => {
            header(image, options)?;
            Ok(Decoded { image: raw.to_rgb(), exif: Exif { orientation: 1, applied: false } })
        }
    }
}

fn decode_file(bytes: &[u8], options: &DecodeOptions) -> Result<Decoded, DecodeError> {
    let header = EncodedHeader::read(bytes)?;
    header.checked(options)?;
    let bytes =
        if header.format == ImageFormat::Jpeg { jpeg::whole(bytes).map_err(of_jpeg)? } else { Cow::Borrowed(bytes) };
    let mut reader = ImageReader::with_format(Cursor::new(&*bytes), header.format);
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(header.metadata);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(of_decoder)?;
    if decoder.dimensions() != (header.width, header.height) {
        // Two readers of one file disagree, so no promise about it holds.
        return Err(damaged(header.format, "its header is ambiguous"));
    }
    // Orientation is advice: where it cannot be read there is none to follow.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    if orientation != Orientation::NoTransforms && options.exif_orientation == OrientationPolicy::Refuse {
        return Err(DecodeError::Orientation(orientation.to_exif()));
    }
    let mut image = DynamicImage::from_decoder(decoder).map_err(of_decoder)?;
    use_whole_range(&mut image);
    // RGB first: turning copies the image.
    let mut image = DynamicImage::ImageRgb8(image.into_rgb8());
    let applied = options.exif_orientation == OrientationPolicy::Apply && orientation != Orientation::NoTransforms;
    if applied {
        image.apply_orientation(orientation);
    }
    let exif = Exif { orientation: orientation.to_exif(), applied };
    Ok(Decoded { image: image.into_rgb8(), exif })
}

/// Cameras of 10, 12 and 14 bits store their values as they are in 16 bits: as fractions of 65535 they would be nearly black.
fn use_whole_range(image: &mut DynamicImage) {
    match image {
        DynamicImage::ImageLuma16(grey) => stretch(grey, 1, 1),
        DynamicImage::ImageLumaA16(grey) => stretch(grey, 2, 1),
        DynamicImage::ImageRgb16(colour) => stretch(colour, 3, 3),
        DynamicImage::ImageRgba16(colour) => stretch(colour, 4, 3),
        // The others have 8 bits: no format that is read here has more.
        DynamicImage::ImageLuma8(_)
        | DynamicImage::ImageLumaA8(_)
        | DynamicImage::ImageRgb8(_)
        | DynamicImage::ImageRgba8(_)
        | DynamicImage::ImageRgb32F(_)
        | DynamicImage::ImageRgba32F(_)
        | _ => {}
    }
}

/// Of each pixel's `channels` the first ones are `colours`.
fn stretch(samples: &mut [u16], channels: usize, colours: usize) {
    let pixels = samples.chunks_exact(channels);
    let highest = pixels.map(|pixel| pixel[..colours].iter().fold(0, |bits, sample| bits | sample));
    let used = highest.fold(0, |bits, pixel| bits | pixel);
    let range = [8, 10, 12, 14].map(|bits| (1_u32 << bits) - 1).into_iter().find(|range| u32::from(used) <= *range);
    let Some(range) = range else { return };
    for sample in samples.chunks_exact_mut(channels).flat_map(|pixel| &mut pixel[..colours]) {
        *sample = u16::try_from(u32::from(*sample) * u32::from(u16::MAX) / range).unwrap_or(u16::MAX);
    }
}

fn of_jpeg(fault: jpeg::Fault) -> DecodeError {
    match fault {
        jpeg::Fault::Ends => DecodeError::Truncated,
        jpeg::Fault::Damaged(words) => damaged(ImageFormat::Jpeg, &words),
    }
}

fn of_decoder(error: ImageError) -> DecodeError {
    let at_end = |io: &std::io::Error| io.kind() == std::io::ErrorKind::UnexpectedEof;
    if matches!(&error, ImageError::IoError(io) if at_end(io)) {
        DecodeError::Truncated
    } else {
        DecodeError::Damaged(error)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::cast_possible_truncation, clippy::float_cmp, reason = "small test images; exact values")]

    use super::*;

    fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    fn decode(bytes: &[u8], options: &DecodeOptions) -> Result<Decoded, DecodeError> {
        super::decode(&Image::Encoded(bytes.to_vec().into()), options)
    }

    fn gradient() -> DynamicImage {
        DynamicImage::ImageRgb8(RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8 * 3, y as u8 * 4, 90])))
    }

    #[test]
    fn every_kind_of_pixel_becomes_rgb() {
        let wanted = gradient().into_rgb8();
        let options = DecodeOptions::default();
        for image in [
            DynamicImage::ImageRgba8(gradient().into_rgba8()),
            DynamicImage::ImageRgb16(gradient().into_rgb16()),
            gradient(),
        ] {
            assert_eq!(decode(&encoded(&image, ImageFormat::Png), &options).unwrap().image, wanted);
        }
        let grey = decode(&encoded(&DynamicImage::ImageLuma8(gradient().into_luma8()), ImageFormat::Png), &options);
        let pixel = *grey.unwrap().image.get_pixel(40, 20);
        assert!(pixel[0] == pixel[1] && pixel[1] == pixel[2]);
        assert_eq!(decode(&encoded(&gradient(), ImageFormat::WebP), &options).unwrap().image, wanted);
    }

    /// 12 bits of a camera in 16 bits of a PNG, and a picture that uses all 16.
    #[test]
    fn sixteen_bits_are_scaled_by_the_range_that_is_used() {
        for (bits, tolerance) in [(8, 0), (10, 1), (12, 1), (14, 1), (16, 0)] {
            let mut stored = gradient().into_rgb16();
            for sample in stored.iter_mut() {
                *sample >>= 16 - bits;
            }
            stored.put_pixel(0, 0, image::Rgb([u16::MAX >> (16 - bits); 3]));
            let png = encoded(&DynamicImage::ImageRgb16(stored), ImageFormat::Png);
            let found = decode(&png, &DecodeOptions::default()).unwrap().image;
            let wanted = gradient().into_rgb8();
            let apart = found.iter().zip(wanted.iter()).skip(3).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(apart <= tolerance, "{bits} bits: {apart} levels");
        }
    }

    #[test]
    fn every_truncation_is_an_error() {
        for format in [ImageFormat::Jpeg, ImageFormat::Png, ImageFormat::WebP] {
            let whole = encoded(&gradient(), format);
            assert!(decode(&whole, &DecodeOptions::default()).is_ok());
            // The last bytes of a PNG (its IEND chunk) and of a WebP (padding) carry no pixels.
            for length in 0..whole.len() - 20 {
                assert!(decode(&whole[..length], &DecodeOptions::default()).is_err(), "{format:?} cut to {length}");
            }
        }
    }

    /// Frames of a motion JPEG.
    #[test]
    fn a_jpeg_without_code_tables_has_the_typical_ones() {
        let whole = encoded(&gradient(), ImageFormat::Jpeg);
        let (mut bare, mut position) = (whole[..2].to_vec(), 2);
        while whole[position + 1] != 0xDA {
            let length = 2 + usize::from(u16::from_be_bytes([whole[position + 2], whole[position + 3]]));
            if whole[position + 1] != 0xC4 {
                bare.extend(&whole[position..position + length]);
            }
            position += length;
        }
        bare.extend(&whole[position..]);
        assert!(bare.len() < whole.len());
        let [bare, whole] = [bare, whole].map(|bytes| decode(&bytes, &DecodeOptions::default()).unwrap().image);
        assert_eq!(bare, whole);
    }

    #[test]
    fn what_would_be_decoded_wrongly_is_refused_in_words() {
        for (file, words) in [("separate-scans.jpg", "store them interleaved"), ("animated.webp", "one of its frames")]
        {
            let bytes = std::fs::read(format!("tests/data/refused/{file}")).unwrap();
            let refusal = decode(&bytes, &DecodeOptions::default()).unwrap_err().to_string();
            assert!(refusal.contains(words), "{refusal}");
        }
    }

    #[test]
    fn a_progressive_jpeg_that_lost_bytes_is_refused() {
        let whole = std::fs::read("tests/data/encodings/progressive.jpg").unwrap();
        assert!(decode(&whole, &DecodeOptions::default()).is_ok());
        let middle = whole.len() / 2;
        let cut = [&whole[..middle], &whole[middle + 20..]].concat();
        assert!(decode(&cut, &DecodeOptions::default()).is_err());
    }

    #[test]
    fn a_header_beyond_the_limits_is_refused_before_allocation() {
        let mut png = encoded(&gradient(), ImageFormat::Png);
        png[16..20].copy_from_slice(&60_000_u32.to_be_bytes());
        png[20..24].copy_from_slice(&60_000_u32.to_be_bytes());
        let checksum = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&checksum.to_be_bytes());
        assert!(matches!(
            decode(&png, &DecodeOptions::default()),
            Err(DecodeError::TooLarge { width: 60_000, height: 60_000, .. })
        ));
    }

    /// A JPEG with an EXIF segment that states an orientation.
    fn turned(orientation: u8) -> Vec<u8> {
        turned_again(&encoded(&gradient(), ImageFormat::Jpeg), orientation)
    }

    /// With such a segment before all others.
    fn turned_again(jpeg: &[u8], orientation: u8) -> Vec<u8> {
        let tiff = [b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".as_slice(), &[orientation, 0, 0, 0], &[0; 4]];
        let exif = [b"Exif\0\0".as_slice(), &tiff.concat()].concat();
        let length = u16::try_from(exif.len() + 2).unwrap().to_be_bytes();
        [&jpeg[..2], &[0xFF, 0xE1], &length, &exif, &jpeg[2..]].concat()
    }

    #[test]
    fn an_orientation_is_refused_applied_or_ignored() {
        let decoded =
            |exif_orientation| decode(&turned(6), &DecodeOptions { exif_orientation, ..DecodeOptions::default() });
        assert!(matches!(decoded(OrientationPolicy::Refuse), Err(DecodeError::Orientation(6))));
        let stored = decoded(OrientationPolicy::Ignore).unwrap();
        assert_eq!((stored.image.dimensions(), stored.exif), ((64, 48), Exif { orientation: 6, applied: false }));
        let applied = decoded(OrientationPolicy::Apply).unwrap();
        assert_eq!(applied.image, image::imageops::rotate90(&stored.image));
        assert!(applied.exif.applied);
        assert!(decode(&turned(1), &DecodeOptions::default()).is_ok());
        // Readers differ in which of two they follow.
        assert!(decode(&turned_again(&turned(1), 1), &DecodeOptions::default()).is_ok());
        for (first, second) in [(6, 1), (1, 6)] {
            let twice = decode(&turned_again(&turned(second), first), &DecodeOptions::default());
            assert!(matches!(twice, Err(DecodeError::Damaged { .. })), "{twice:?}");
        }
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0_u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xEDB8_8320 } else { c >> 1 })
        })
    }
}
