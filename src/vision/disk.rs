use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder as _, ImageFormat, ImageReader, RgbImage};
use thiserror::Error;

use super::decode::decode;
use super::error::DecodeError;
use super::header::check_size;
use super::options::{DecodeOptions, OrientationPolicy};
use super::source::Image;

/// An image file that cannot be read. Whoever asked for it knows its name.
#[derive(Debug, Error)]
pub enum FileError {
    #[error(transparent)]
    Read(#[from] std::io::Error),
    #[error(transparent)]
    Decode(#[from] DecodeError),
}

/// Reads an image of a dataset: what [`decode`] takes, and TIFF, which no server should have to.
///
/// # Errors
/// When the file cannot be read, or is no image within the limits of the options.
pub fn read_image(path: &Path, options: &DecodeOptions) -> Result<RgbImage, FileError> {
    let bytes = std::fs::read(path)?;
    if image::guess_format(&bytes).ok() == Some(ImageFormat::Tiff) {
        return Ok(tiff(&bytes, options)?);
    }
    Ok(decode(&Image::Encoded(bytes.into()), options)?.image)
}

fn tiff(bytes: &[u8], options: &DecodeOptions) -> Result<RgbImage, DecodeError> {
    let damaged = DecodeError::Damaged;
    let mut decoder =
        ImageReader::with_format(Cursor::new(bytes), ImageFormat::Tiff).into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height, options)?;
    let orientation = decoder.orientation().map_err(damaged)?;
    let turned = orientation != image::metadata::Orientation::NoTransforms;
    if turned && options.exif_orientation == OrientationPolicy::Refuse {
        return Err(DecodeError::Orientation(orientation.to_exif()));
    }
    let mut image = DynamicImage::from_decoder(decoder).map_err(damaged)?;
    if turned && options.exif_orientation == OrientationPolicy::Apply {
        image.apply_orientation(orientation);
    }
    Ok(image.into_rgb8())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grey and colour, as datasets have them; a server takes neither.
    #[test]
    fn tiff_is_read_from_disk_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("000000.tif");
        let grey = image::GrayImage::from_fn(40, 30, |x, y| image::Luma([u8::try_from(5 * x + y).unwrap()]));
        let options = DecodeOptions::default();
        for image in
            [DynamicImage::ImageLuma8(grey.clone()), DynamicImage::ImageRgb8(DynamicImage::from(grey).into_rgb8())]
        {
            image.save(&path).unwrap();
            assert_eq!(read_image(&path, &options).unwrap(), image.into_rgb8());
            let bytes = std::fs::read(&path).unwrap();
            assert!(matches!(decode(&Image::Encoded(bytes.into()), &options), Err(DecodeError::UnknownFormat)));
        }
        let small = DecodeOptions { max_side_px: 39, ..options };
        assert!(matches!(read_image(&path, &small), Err(FileError::Decode(DecodeError::TooLarge { .. }))));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(matches!(read_image(&path, &options), Err(FileError::Decode(DecodeError::Damaged(_)))));
    }
}
