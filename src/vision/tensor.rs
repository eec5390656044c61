/// Interleaved 8-bit RGB images to planes of floats, `(byte / 255 - mean) / std` for each channel. `pixels` is the
/// number of pixels of one image.
#[must_use]
pub fn to_planes(rgb: &[u8], pixels: usize, mean: [f32; 3], std: [f32; 3]) -> Vec<f32> {
    let mut planes = Vec::with_capacity(rgb.len());
    for image in rgb.chunks_exact(3 * pixels) {
        for channel in 0..3 {
            let (scale, shift) = (1.0 / (255.0 * std[channel]), mean[channel] / std[channel]);
            planes.extend(image.iter().skip(channel).step_by(3).map(|byte| f32::from(*byte) * scale - shift));
        }
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_normalised_by_channel() {
        let two_images = [0, 51, 255, 255, 51, 0, 10, 20, 30, 40, 50, 60];
        let planes = to_planes(&two_images, 2, [0.5, 0.0, 0.0], [0.5, 1.0, 0.1]);
        let first_image = [-1.0, 1.0, 0.2, 0.2, 10.0, 0.0];
        assert!(planes.iter().zip(first_image).all(|(found, wanted)| (found - wanted).abs() < 1e-5), "{planes:?}");
        assert!((planes[6] - (10.0 / 255.0 - 0.5) / 0.5).abs() < 1e-5);
    }
}
