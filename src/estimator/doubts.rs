//! What an image or its camera says against every pose in it, before any network has seen it.

use image::RgbImage;
use posed_core::geometry::Camera;

use super::answer::MeasureError;
use super::verdict::Reason;

/// Every so manieth pixel of every so manieth row is looked at.
const STEP: usize = 4;
/// A pixel whose channels differ by more has a colour. Noise and compression leave less where a camera has one channel.
const COLOURED: u8 = 4;
/// A pixel with a brighter channel is not black.
const BRIGHT: u8 = 32;
/// An image with a smaller share of coloured pixels has one channel, or three that are equal.
const LEAST_COLOURED: f64 = 1e-3;
/// An image with a smaller share of bright pixels shows next to nothing.
const LEAST_BRIGHT: f64 = 0.01;
/// Least focal length, as a share of the longer side: lenses without a fisheye model see at most 140 degrees.
const LEAST_FOCAL: f64 = 0.18;
/// Where in an image a lens has its axis, as a share of width or height: regions and wrong parameters have it elsewhere.
const PRINCIPAL_POINT: std::ops::RangeInclusive<f64> = 0.1..=0.9;

/// Reasons not to trust any pose of an image.
pub(super) fn of_image(image: &RgbImage, camera: &Camera) -> impl Iterator<Item = Reason> {
    let (coloured, bright) = shares(image);
    let size = [image.width(), image.height()].map(f64::from);
    let centred = camera.principal_point().iter().zip(size).all(|(c, side)| PRINCIPAL_POINT.contains(&(c / side)));
    let longer = size[0].max(size[1]);
    let possible = camera.is_fisheye() || camera.focal().min() >= LEAST_FOCAL * longer;
    let doubts = [
        (bright < LEAST_BRIGHT, Reason::DarkImage),
        (coloured < LEAST_COLOURED, Reason::GreyImage),
        (!centred || !possible, Reason::CameraSuspect),
    ];
    doubts.into_iter().filter_map(|(holds, reason)| holds.then_some(reason))
}

/// Whether a reference can be measured in an image: what rests on it inherits its faults.
///
/// # Errors
/// [`MeasureError::Unfit`] says why not.
pub fn fit_to_measure(image: &RgbImage, camera: &Camera) -> Result<(), MeasureError> {
    let reasons: Vec<String> = of_image(image, camera).map(|reason| reason.to_string()).collect();
    if reasons.is_empty() { Ok(()) } else { Err(MeasureError::Unfit { reasons: reasons.join(", ") }) }
}

/// The shares of pixels that have a colour, and that are bright.
fn shares(image: &RgbImage) -> (f64, f64) {
    let (mut seen, mut coloured, mut bright) = (0_u32, 0_u32, 0_u32);
    for row in image.rows().step_by(STEP) {
        for pixel in row.step_by(STEP) {
            let [red, green, blue] = pixel.0;
            let (least, most) = (red.min(green).min(blue), red.max(green).max(blue));
            seen += 1;
            coloured += u32::from(most - least > COLOURED);
            bright += u32::from(most > BRIGHT);
        }
    }
    (f64::from(coloured) / f64::from(seen), f64::from(bright) / f64::from(seen))
}
