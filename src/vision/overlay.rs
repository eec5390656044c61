use std::io::Cursor;

use font8x8::legacy::BASIC_LEGACY;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ImageError, ImageFormat, Rgb, RgbImage};
use nalgebra::{Vector2, Vector3};

use super::region::BoundingBox;
use posed_core::geometry::{Camera, Pose};
use posed_core::pnp::Status;

/// One pose to draw.
#[derive(Clone, Debug)]
pub struct Mark {
    pub bounding_box: BoundingBox,
    pub colour: [u8; 3],
    pub label: String,
    pub pose: Option<PoseMark>,
}

/// What there is to draw where a pose is known.
#[derive(Clone, Debug)]
pub struct PoseMark {
    pub camera_from_object: Pose,
    /// Length of the axes drawn at the object's origin, metres.
    pub axis_length_m: f64,
    /// Corners of a box in the camera's frame, metres; bit k of the index is axis k.
    pub corners: [Vector3<f64>; 8],
}

/// Of x, y and z.
pub const AXIS_COLOURS: [[u8; 3]; 3] = [[230, 30, 30], [30, 190, 40], [40, 90, 255]];
/// Offsets of the thin lines that make up a thick stroke, pixels.
const THICK: &[f32] = &[-1.0, 0.0, 1.0];
const THIN: &[f32] = &[0.0];
const JPEG_QUALITY: u8 = 90;
/// A letter is 8 x 8 dots, each 1 x 2 pixels: the shape of letters on a terminal.
const DOT_HEIGHT: u32 = 2;
const LETTER_WIDTH: u32 = 8;
const LETTER_HEIGHT: u32 = 8 * DOT_HEIGHT;

/// Draws detection boxes, the boxes and axes (x red, y green, z blue) of poses, and labels into an image.
pub fn draw_marks(image: &mut RgbImage, camera: &Camera, marks: &[Mark]) {
    for mark in marks {
        draw_region(image, &mark.bounding_box, mark.colour);
        if let Some(pose) = &mark.pose {
            draw_pose(image, camera, pose, mark.colour);
        }
    }
    // Labels last, so that no line crosses them.
    for mark in marks {
        draw_label(image, &mark.bounding_box, &mark.label, mark.colour);
    }
}

/// The colour that stands for a status.
#[must_use]
pub fn status_colour(status: Status) -> [u8; 3] {
    match status {
        Status::Ok => [60, 220, 90],
        Status::Ambiguous => [250, 200, 40],
        Status::LowConfidence => [250, 130, 30],
        Status::Rejected => [230, 40, 40],
    }
}

/// Corners of the box about points, along their axes; bit k of the index is axis k.
#[must_use]
pub fn box_corners(points: &[Vector3<f64>]) -> [Vector3<f64>; 8] {
    let first = points.first().copied().unwrap_or_default();
    let low = points.iter().fold(first, |low, point| low.inf(point));
    let high = points.iter().fold(first, |high, point| high.sup(point));
    std::array::from_fn(|index| Vector3::from_fn(|axis, _| if index >> axis & 1 == 1 { high[axis] } else { low[axis] }))
}

/// Pairs of such corners with an edge between them.
pub fn box_edges() -> impl Iterator<Item = (usize, usize)> {
    let edges = |from: usize| (0..3).map(move |axis| (from, from | 1 << axis));
    (0..8).flat_map(edges).filter(|(from, to)| from != to)
}

fn draw_pose(image: &mut RgbImage, camera: &Camera, pose: &PoseMark, colour: [u8; 3]) {
    let pixel = |point: &Vector3<f64>| camera.project(point).ok();
    let corners = pose.corners.each_ref().map(pixel);
    for (from, to) in box_edges() {
        if let (Some(from), Some(to)) = (corners[from], corners[to]) {
            draw_stroke(image, from, to, colour, THIN);
        }
    }
    let Some(origin) = pixel(pose.camera_from_object.translation()) else { return };
    for (axis, colour) in AXIS_COLOURS.into_iter().enumerate() {
        let mut tip = Vector3::zeros();
        tip[axis] = pose.axis_length_m;
        if let Some(tip) = pixel(&pose.camera_from_object.transform(&tip)) {
            draw_stroke(image, origin, tip, colour, THICK);
        }
    }
}

/// The image as a PNG or JPEG file.
///
/// # Errors
/// When the encoder fails.
pub fn encode(image: &RgbImage, format: ImageFormat) -> Result<Vec<u8>, ImageError> {
    // Noise grows a little; a buffer that grew by doubling would take as much again.
    let size = image.as_raw().len();
    let mut bytes = Cursor::new(Vec::with_capacity(size + size / 16));
    if format == ImageFormat::Jpeg {
        image.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY))?;
    } else {
        image.write_with_encoder(PngEncoder::new(&mut bytes))?;
    }
    Ok(bytes.into_inner())
}

fn draw_region(image: &mut RgbImage, region: &BoundingBox, colour: [u8; 3]) {
    let (left, top) = (region.x, region.y);
    let (right, bottom) = (left + region.width - 1.0, top + region.height - 1.0);
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom)].map(|(x, y)| Vector2::new(x, y));
    for (k, corner) in corners.iter().enumerate() {
        draw_stroke(image, *corner, corners[(k + 1) % 4], colour, THICK);
    }
}

/// Text on a bar of the mark's colour, above its box, or inside where there is no room above.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
fn draw_label(image: &mut RgbImage, region: &BoundingBox, label: &str, colour: [u8; 3]) {
    let bar = (label.chars().count() as u32 * LETTER_WIDTH, LETTER_HEIGHT + 2 * DOT_HEIGHT);
    let left = (region.x.max(0.0) as u32).min(image.width().saturating_sub(bar.0));
    let top = if region.y >= f64::from(bar.1) { region.y as u32 - bar.1 } else { region.y.max(0.0) as u32 };
    let mut dot = |x: u32, y: u32, colour| {
        if let Some(pixel) = image.get_pixel_mut_checked(left + x, top + y) {
            *pixel = Rgb(colour);
        }
    };
    for y in 0..bar.1 {
        (0..bar.0).for_each(|x| dot(x, y, colour));
    }
    for (index, letter) in (0..).zip(label.chars()) {
        let rows = BASIC_LEGACY.get(letter as usize).copied().unwrap_or_default();
        for (y, row) in (0..LETTER_HEIGHT).map(|y| (y, rows[(y / DOT_HEIGHT) as usize])) {
            for x in (0..LETTER_WIDTH).filter(|x| row >> x & 1 == 1) {
                dot(index * LETTER_WIDTH + x, DOT_HEIGHT + y, [0; 3]);
            }
        }
    }
}

/// A line, as many thin lines wide as there are offsets.
#[expect(clippy::cast_possible_truncation, reason = "the rasteriser takes f32")]
fn draw_stroke(image: &mut RgbImage, from: Vector2<f64>, to: Vector2<f64>, colour: [u8; 3], offsets: &[f32]) {
    // Far outside, the line's rasteriser would walk millions of invisible pixels.
    let limit = 4.0 * f64::from(image.width().max(image.height()));
    if from.amax() > limit || to.amax() > limit {
        return;
    }
    for dx in offsets {
        for dy in offsets {
            let shift = |p: Vector2<f64>| (p.x as f32 + dx, p.y as f32 + dy);
            imageproc::drawing::draw_line_segment_mut(image, shift(from), shift(to), Rgb(colour));
        }
    }
}
