use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use imageproc::drawing::draw_line_segment_mut;
use nalgebra::{Vector2, Vector3};

use crate::vision::{AXIS_COLOURS, BoundingBox, box_edges, encode};
use posed_core::geometry::{Camera, Pose};

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

/// A pose to draw: the box about the object, and the object's axes.
pub struct Outline {
    /// In the camera's frame, metres; bit k of the index is axis k.
    pub corners: [Vector3<f64>; 8],
    pub colour: [u8; 3],
    /// `camera_from_object`, and how long to draw the axes, metres.
    pub axes: Option<(Pose, f64)>,
}

/// The part of an image about a box as a small JPEG file, with poses drawn in: axes x red, y green, z blue.
///
/// # Errors
/// When the encoder fails.
pub fn close_up(
    image: &RgbImage,
    camera: &Camera,
    region: &BoundingBox,
    outlines: &[Outline],
) -> Result<Vec<u8>, image::ImageError> {
    let (left, top, side) = square(region, image.dimensions());
    let cut = imageops::crop_imm(image, left, top, side.0, side.1).to_image();
    let longer = side.0.max(side.1);
    let small = |side: u32| (side * SIDE / longer).max(1);
    let mut small = imageops::resize(&cut, small(side.0), small(side.1), FilterType::CatmullRom);
    let scale = f64::from(SIDE) / f64::from(longer);
    let corner = Vector2::new(f64::from(left), f64::from(top));
    // Centres of pixels are at integers, here and there.
    let place = |point: &Vector3<f64>| {
        let pixel = camera.project(point).ok()?;
        Some(((pixel - corner).add_scalar(0.5) * scale).add_scalar(-0.5))
    };
    for outline in outlines {
        let corners = outline.corners.each_ref().map(place);
        for (from, to) in box_edges() {
            stroke(&mut small, corners[from], corners[to], outline.colour);
        }
        let Some((pose, length_m)) = &outline.axes else { continue };
        for (axis, colour) in AXIS_COLOURS.into_iter().enumerate() {
            let tip = pose.transform(&Vector3::ith(axis, *length_m));
            stroke(&mut small, place(pose.translation()), place(&tip), colour);
        }
    }
    encode(&small, image::ImageFormat::Jpeg)
}

/// Two pixels wide.
#[expect(clippy::cast_possible_truncation, reason = "the rasteriser takes f32")]
fn stroke(image: &mut RgbImage, from: Option<Vector2<f64>>, to: Option<Vector2<f64>>, colour: [u8; 3]) {
    // Far outside, the rasteriser would walk millions of invisible pixels.
    let near = |point: &Vector2<f64>| point.amax() < 4.0 * f64::from(SIDE);
    let (Some(from), Some(to)) = (from.filter(near), to.filter(near)) else { return };
    for shift in [0.0, 1.0] {
        let ends = [from, to].map(|point| (point.x as f32 + shift, point.y as f32));
        draw_line_segment_mut(image, ends[0], ends[1], Rgb(colour));
    }
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
