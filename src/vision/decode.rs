use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, RgbImage};
use thiserror::Error;

/// What an image may demand before anything is allocated for it.
#[derive(Clone, Debug)]
pub struct ImageLimits {
    pub max_side_px: u32,
    pub max_pixels: u64,
}

impl Default for ImageLimits {
    fn default() -> Self {
        Self { max_side_px: 8192, max_pixels: 24_000_000 }
    }
}

/// Smaller than this and no object could be seen in it.
const MIN_SIDE_PX: u32 = 16;

/// Bytes that are not an image to estimate poses from.
#[derive(Debug, Error)]
pub enum DecodeError {
    #[error("the body is empty; post the bytes of a JPEG, PNG or WebP image")]
    Empty,
    #[error("the body is not a JPEG, PNG or WebP image (its first bytes are none of theirs)")]
    UnknownFormat,
    #[error("image is {width}x{height}; the limits are {max_side_px} pixels a side and {max_pixels} pixels in all")]
    TooLarge { width: u32, height: u32, max_side_px: u32, max_pixels: u64 },
    #[error("image is {width}x{height}; at least {MIN_SIDE_PX} pixels a side are needed")]
    TooSmall { width: u32, height: u32 },
    #[error("image is truncated: its last part is missing")]
    Truncated,
    #[error(
        "image asks to be turned (EXIF orientation {0}), so it is unclear which pixels the camera parameters mean; \
         post the pixels as the sensor read them, without an orientation"
    )]
    Orientation(u8),
    #[error("image is damaged: {0}")]
    Damaged(#[source] image::ImageError),
}

/// Decodes a JPEG, PNG or WebP to 8-bit RGB.
///
/// Grey becomes RGB, alpha is dropped, 16 bits are reduced to 8. Sizes are checked on the header, before the pixels are
/// allocated. An EXIF orientation other than "as is" is refused.
///
/// # Errors
/// [`DecodeError`] says what is wrong with the bytes and which limit they break.
pub fn decode(bytes: &[u8], limits: &ImageLimits) -> Result<RgbImage, DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    let Ok(format @ (ImageFormat::Jpeg | ImageFormat::Png | ImageFormat::WebP)) = image::guess_format(bytes) else {
        return Err(DecodeError::UnknownFormat);
    };
    if format == ImageFormat::Jpeg && jpeg_is_truncated(bytes) {
        return Err(DecodeError::Truncated);
    }
    let mut decoder =
        ImageReader::with_format(Cursor::new(bytes), format).into_decoder().map_err(DecodeError::Damaged)?;
    let (width, height) = decoder.dimensions();
    let ImageLimits { max_side_px, max_pixels } = *limits;
    if width.max(height) > max_side_px || u64::from(width) * u64::from(height) > max_pixels {
        return Err(DecodeError::TooLarge { width, height, max_side_px, max_pixels });
    }
    if width.min(height) < MIN_SIDE_PX {
        return Err(DecodeError::TooSmall { width, height });
    }
    // Orientation is advice: where it cannot be read there is none to follow.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    if orientation != Orientation::NoTransforms {
        return Err(DecodeError::Orientation(orientation.to_exif()));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|error| {
        let at_end = |io: &std::io::Error| io.kind() == std::io::ErrorKind::UnexpectedEof;
        if matches!(&error, image::ImageError::IoError(io) if at_end(io)) {
            DecodeError::Truncated
        } else {
            DecodeError::Damaged(error)
        }
    })?;
    Ok(image.into_rgb8())
}

/// Decoders fill the missing part of a JPEG with grey and report success, which would cost a detection in silence. Here
/// the end marker must follow the last scan (markers cannot occur inside a scan's data).
fn jpeg_is_truncated(bytes: &[u8]) -> bool {
    let last = |marker: u8| bytes.windows(2).rposition(|pair| pair == [0xFF, marker]);
    match (last(0xDA), last(0xD9)) {
        (Some(start_of_scan), Some(end_of_image)) => end_of_image < start_of_scan,
        (Some(_), None) => true,
        (None, Some(_) | None) => false, // no scan at all: the decoder will say so
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

    fn gradient() -> DynamicImage {
        DynamicImage::ImageRgb8(RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8 * 3, y as u8 * 4, 90])))
    }

    #[test]
    fn every_kind_of_pixel_becomes_rgb() {
        let wanted = gradient().into_rgb8();
        let limits = ImageLimits::default();
        for image in [
            DynamicImage::ImageRgba8(gradient().into_rgba8()),
            DynamicImage::ImageRgb16(gradient().into_rgb16()),
            gradient(),
        ] {
            assert_eq!(decode(&encoded(&image, ImageFormat::Png), &limits).unwrap(), wanted);
        }
        let grey = decode(&encoded(&DynamicImage::ImageLuma8(gradient().into_luma8()), ImageFormat::Png), &limits);
        let pixel = *grey.unwrap().get_pixel(40, 20);
        assert!(pixel[0] == pixel[1] && pixel[1] == pixel[2]);
        assert_eq!(decode(&encoded(&gradient(), ImageFormat::WebP), &limits).unwrap(), wanted);
    }

    #[test]
    fn every_truncation_is_an_error() {
        for format in [ImageFormat::Jpeg, ImageFormat::Png, ImageFormat::WebP] {
            let whole = encoded(&gradient(), format);
            assert!(decode(&whole, &ImageLimits::default()).is_ok());
            // The last bytes of a PNG (its IEND chunk) and of a WebP (padding) carry no pixels.
            for length in 0..whole.len() - 20 {
                assert!(decode(&whole[..length], &ImageLimits::default()).is_err(), "{format:?} cut to {length}");
            }
        }
    }

    #[test]
    fn a_header_beyond_the_limits_is_refused_before_allocation() {
        let mut png = encoded(&gradient(), ImageFormat::Png);
        png[16..20].copy_from_slice(&60_000_u32.to_be_bytes());
        png[20..24].copy_from_slice(&60_000_u32.to_be_bytes());
        let checksum = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&checksum.to_be_bytes());
        assert!(matches!(
            decode(&png, &ImageLimits::default()),
            Err(DecodeError::TooLarge { width: 60_000, height: 60_000, .. })
        ));
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0_u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xEDB8_8320 } else { c >> 1 })
        })
    }
}
