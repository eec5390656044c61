use image::{Rgb, RgbImage};

/// Where the red pixels of a Bayer pattern are: the parity of their column and row. Blue ones are diagonal to them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BayerPattern {
    pub red_x: u32,
    pub red_y: u32,
}

impl BayerPattern {
    /// Bilinear: a missing colour is the mean of its nearest neighbours. Beyond its edges the image is mirrored about its
    /// outermost pixels, which keeps the pattern. `width` and `height` are at least 2.
    pub(super) fn demosaic(self, data: &[u8], step: usize, width: u32, height: u32) -> RgbImage {
        let mut image = RgbImage::new(width, height);
        let row = |y: u32| &data[y as usize * step..][..width as usize];
        for (y, pixels) in (0..height).zip(image.rows_mut()) {
            let (up, down) = neighbours(y, height);
            let (above, here, below) = (row(up), row(y), row(down));
            let red_row = y % 2 == self.red_y;
            for (x, pixel) in (0..width).zip(pixels) {
                let (left, right) = neighbours(x, width);
                let [left, x_here, right] = [left, x, right].map(|column| column as usize);
                let own = here[x_here];
                let beside = || mean([here[left], here[right]]);
                let upright = || mean([above[x_here], below[x_here]]);
                let cross = || mean([here[left], here[right], above[x_here], below[x_here]]);
                let diagonal = || mean([above[left], above[right], below[left], below[right]]);
                *pixel = Rgb(match (red_row, x % 2 == self.red_x) {
                    (true, true) => [own, cross(), diagonal()],
                    (true, false) => [beside(), own, upright()],
                    (false, true) => [upright(), own, beside()],
                    (false, false) => [diagonal(), cross(), own],
                });
            }
        }
        image
    }
}

/// The neighbours before and after, those beyond an edge mirrored.
fn neighbours(at: u32, size: u32) -> (u32, u32) {
    (if at == 0 { 1 } else { at - 1 }, if at + 1 == size { size - 2 } else { at + 1 })
}

/// Rounded.
fn mean<const N: usize>(values: [u8; N]) -> u8 {
    let sum: usize = values.into_iter().map(usize::from).sum();
    // The mean of bytes is a byte.
    u8::try_from((sum + N / 2) / N).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::cast_possible_truncation, reason = "small test images")]

    use proptest::prelude::*;

    use super::*;

    const PATTERNS: [BayerPattern; 4] = [
        BayerPattern { red_x: 0, red_y: 0 },
        BayerPattern { red_x: 1, red_y: 0 },
        BayerPattern { red_x: 0, red_y: 1 },
        BayerPattern { red_x: 1, red_y: 1 },
    ];

    /// What a sensor with this pattern sees of an image.
    fn mosaic(image: &RgbImage, pattern: BayerPattern) -> Vec<u8> {
        let channel = |x: u32, y: u32| match (x % 2 == pattern.red_x, y % 2 == pattern.red_y) {
            (true, true) => 0,
            (false, false) => 2,
            (true, false) | (false, true) => 1,
        };
        image.enumerate_pixels().map(|(x, y, pixel)| pixel[channel(x, y)]).collect()
    }

    proptest! {
        #[test]
        fn one_colour_comes_back_everywhere(colour: [u8; 3], half_width in 1_u32..9, half_height in 1_u32..9) {
            let image = RgbImage::from_pixel(2 * half_width, 2 * half_height, Rgb(colour));
            for pattern in PATTERNS {
                let (width, height) = image.dimensions();
                let seen = pattern.demosaic(&mosaic(&image, pattern), width as usize, width, height);
                prop_assert_eq!(&seen, &image);
            }
        }
    }

    /// Of other slopes for each channel and direction, so that no two of them may be confused.
    #[test]
    fn gradients_come_back_within_the_border() {
        let image = RgbImage::from_fn(32, 24, |x, y| Rgb([3 * x + y, 200 - 2 * x + y, 30 + 5 * y].map(|v| v as u8)));
        for pattern in PATTERNS {
            let seen = pattern.demosaic(&mosaic(&image, pattern), 32, 32, 24);
            for (x, y, pixel) in seen.enumerate_pixels() {
                let off = (0..3).map(|c| pixel[c].abs_diff(image.get_pixel(x, y)[c])).max().unwrap();
                let inside = (1..31).contains(&x) && (1..23).contains(&y);
                assert!(!inside || off <= 1, "{pattern:?} ({x}, {y}): {pixel:?}");
            }
        }
    }
}
