use image::RgbImage;
use image::imageops::{self, FilterType};

use crate::vision::{BoundingBox, Mark, draw_marks, encode};
use posed_core::geometry::Camera;

/// Side of a picture of a contact sheet, pixels.
const SIDE: u32 = 240;
/// Of the larger side of the object's box.
const MARGIN: f64 = 1.8;

/// Views of one kind, of one object in one split.
pub struct Sheet {
    pub split: String,
    pub object: String,
    pub title: &'static str,
    pub pictures: Vec<Picture>,
}

/// One view.
pub struct Picture {
    /// A JPEG file.
    pub jpeg: Vec<u8>,
    /// Lines of text below it.
    pub captions: Vec<String>,
}

/// The part of an image about a box as a small JPEG file, with marks drawn in.
///
/// # Errors
/// When the encoder fails.
pub fn close_up(
    image: &RgbImage,
    camera: &Camera,
    region: &BoundingBox,
    marks: &[Mark],
) -> Result<Vec<u8>, image::ImageError> {
    let mut drawn = image.clone();
    draw_marks(&mut drawn, camera, marks);
    let (left, top, side) = square(region, image.dimensions());
    let cut = imageops::crop_imm(&drawn, left, top, side.0, side.1).to_image();
    let longer = side.0.max(side.1);
    let small = |side: u32| (side * SIDE / longer).max(1);
    let small = imageops::resize(&cut, small(side.0), small(side.1), FilterType::Triangle);
    encode(&small, image::ImageFormat::Jpeg)
}

/// Left, top, width and height of a square about a box, as far as it lies in the image.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
fn square(region: &BoundingBox, (width, height): (u32, u32)) -> (u32, u32, (u32, u32)) {
    let (centre, half) = (region.centre(), (0.5 * MARGIN * region.extent()).max(8.0));
    let within = |value: f64, size: u32| value.clamp(0.0, f64::from(size)) as u32;
    let span = |centre: f64, size: u32| {
        let low = within(centre - half, size).min(size.saturating_sub(1));
        (low, within(centre + half, size).saturating_sub(low).max(1))
    };
    let ((left, wide), (top, high)) = (span(centre.x, width), span(centre.y, height));
    (left, top, (wide, high))
}
