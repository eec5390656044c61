/// How a network wants its pixels: the file of an image has interleaved RGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrangement {
    /// One plane for each channel, else one pixel after the other.
    pub planar: bool,
    /// Blue first.
    pub bgr: bool,
}

/// Interleaved 8-bit RGB images in another arrangement. `pixels` is the number of pixels of one image; `value` turns a byte
/// of a channel, counted as the network counts them, into the network's number.
pub fn arrange<T>(rgb: &[u8], pixels: usize, to: Arrangement, value: impl Fn(usize, u8) -> T) -> Vec<T> {
    let source = |channel: usize| if to.bgr { 2 - channel } else { channel };
    let mut arranged = Vec::with_capacity(rgb.len());
    for image in rgb.chunks_exact(3 * pixels) {
        if to.planar {
            for channel in 0..3 {
                arranged.extend(image.iter().skip(source(channel)).step_by(3).map(|byte| value(channel, *byte)));
            }
        } else {
            let of_pixel = |pixel: &[u8; 3]| [0, 1, 2].map(|channel| value(channel, pixel[source(channel)]));
            arranged.extend(image.as_chunks::<3>().0.iter().flat_map(of_pixel));
        }
    }
    arranged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_lie_where_the_network_wants_them() {
        let two_images = [0, 51, 255, 255, 52, 1, 10, 20, 30, 40, 50, 60];
        let arranged =
            |planar, bgr| arrange(&two_images, 2, Arrangement { planar, bgr }, |channel, byte| (channel, byte));
        let values = |planar, bgr| arranged(planar, bgr).into_iter().map(|(_, byte)| byte).collect::<Vec<_>>();
        assert_eq!(values(false, false), two_images);
        assert_eq!(values(false, true), [255, 51, 0, 1, 52, 255, 30, 20, 10, 60, 50, 40]);
        assert_eq!(values(true, false), [0, 255, 51, 52, 255, 1, 10, 40, 20, 50, 30, 60]);
        assert_eq!(values(true, true), [255, 1, 51, 52, 0, 255, 30, 60, 20, 50, 10, 40]);
        for planar in [false, true] {
            // Normalisation is by the network's channels: its first one is blue here.
            let first = |(channel, byte): &(usize, u8)| *channel == 0 && *byte == 255;
            assert!(arranged(planar, true).iter().any(first));
        }
    }
}
