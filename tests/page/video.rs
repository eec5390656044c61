//! A film for the browser's fake camera.

use std::io::Write as _;
use std::path::Path;

use image::RgbImage;

/// Writes an image as an uncompressed film of two frames (YUV4MPEG2, 4:2:0, studio range of BT.601).
pub(crate) fn write(path: &Path, image: &RgbImage) {
    let (width, height) = image.dimensions();
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    writeln!(file, "YUV4MPEG2 W{width} H{height} F10:1 Ip A1:1 C420").unwrap();
    let of = |x: u32, y: u32| image.get_pixel(x, y).0.map(f64::from);
    let mut planes = Vec::new();
    for y in 0..height {
        planes.extend((0..width).map(|x| sample(16.0, [0.257, 0.504, 0.098], of(x, y))));
    }
    for weights in [[-0.148, -0.291, 0.439], [0.439, -0.368, -0.071]] {
        for y in (0..height).step_by(2) {
            planes.extend((0..width).step_by(2).map(|x| {
                let four = [of(x, y), of(x + 1, y), of(x, y + 1), of(x + 1, y + 1)];
                let mean = [0, 1, 2].map(|channel| four.iter().map(|pixel| pixel[channel]).sum::<f64>() / 4.0);
                sample(128.0, weights, mean)
            }));
        }
    }
    for _ in 0..2 {
        file.write_all(b"FRAME\n").unwrap();
        file.write_all(&planes).unwrap();
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
fn sample(zero: f64, weights: [f64; 3], rgb: [f64; 3]) -> u8 {
    let value = zero + weights.iter().zip(rgb).map(|(weight, channel)| weight * channel).sum::<f64>();
    value.round().clamp(0.0, 255.0) as u8
}
