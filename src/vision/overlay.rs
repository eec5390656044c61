use std::io::Cursor;

use image::{ImageError, ImageFormat, Rgb, RgbImage};
use nalgebra::{Vector2, Vector3};

use super::resample::BoundingBox;
use crate::geometry::{Camera, Pose};

/// One pose to draw.
#[derive(Clone, Debug)]
pub struct Mark {
    pub bounding_box: BoundingBox,
    pub box_colour: [u8; 3],
    pub camera_from_object: Option<Pose>,
    /// Length of the axes drawn at the object's origin, metres.
    pub axis_length_m: f64,
}

const AXIS_COLOURS: [[u8; 3]; 3] = [[230, 30, 30], [30, 190, 40], [40, 90, 255]];
/// Offsets of the thin lines that make up a stroke, pixels.
const STROKE: [f32; 3] = [-1.0, 0.0, 1.0];

/// Draws boxes and object axes (x red, y green, z blue) into an image.
pub fn draw_marks(image: &mut RgbImage, camera: &Camera, marks: &[Mark]) {
    for mark in marks {
        draw_box(image, &mark.bounding_box, mark.box_colour);
        let Some(pose) = mark.camera_from_object else { continue };
        let pixel = |point: Vector3<f64>| camera.project(&pose.transform(&point)).ok();
        let Some(origin) = pixel(Vector3::zeros()) else { continue };
        for (axis, colour) in AXIS_COLOURS.into_iter().enumerate() {
            let mut tip = Vector3::zeros();
            tip[axis] = mark.axis_length_m;
            if let Some(tip) = pixel(tip) {
                draw_stroke(image, origin, tip, colour);
            }
        }
    }
}

/// # Errors
/// When the encoder fails.
pub fn encode_png(image: &RgbImage) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

fn draw_box(image: &mut RgbImage, region: &BoundingBox, colour: [u8; 3]) {
    let (left, top) = (region.x, region.y);
    let (right, bottom) = (left + region.width - 1.0, top + region.height - 1.0);
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom)].map(|(x, y)| Vector2::new(x, y));
    for (k, corner) in corners.iter().enumerate() {
        draw_stroke(image, *corner, corners[(k + 1) % 4], colour);
    }
}

/// A line a few pixels wide.
#[expect(clippy::cast_possible_truncation, reason = "the rasteriser takes f32")]
fn draw_stroke(image: &mut RgbImage, from: Vector2<f64>, to: Vector2<f64>, colour: [u8; 3]) {
    // Far outside, the line's rasteriser would walk millions of invisible pixels.
    let limit = 4.0 * f64::from(image.width().max(image.height()));
    if from.amax() > limit || to.amax() > limit {
        return;
    }
    for dx in STROKE {
        for dy in STROKE {
            let shift = |p: Vector2<f64>| (p.x as f32 + dx, p.y as f32 + dy);
            imageproc::drawing::draw_line_segment_mut(image, shift(from), shift(to), Rgb(colour));
        }
    }
}
