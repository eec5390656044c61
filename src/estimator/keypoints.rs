//! Crops through a keypoint net, and back to image pixels.

use std::ops::RangeInclusive;

use fast_image_resize::Resizer;
use image::RgbImage;
use nalgebra::{Vector2, Vector3};

use super::answer::{Detection, EstimateError, KeypointPrediction};
use super::ensemble::{combined, spread_of};
use super::evidence;
use super::reading::{in_image, raw_keypoints};
use super::second_peaks::{self, Solved};
use crate::model::{CropVariant, KeypointManifest, KeypointNet, RuntimeError, SecondLook};
use crate::vision::{BoundingBox, ResampleError, Resampled, Square, crop_squares};
use posed_core::geometry::Camera;
use posed_core::pnp::{PnpError, Solution};

/// Crops that go through a network at once. More bring no speed, but memory that ONNX Runtime keeps: with 16 instead of 4
/// the demo server holds twice as much.
pub(super) const MAX_BATCH: usize = 4;

/// A second look is taken at a place whose side is about that of the box: elsewhere the first one went wrong.
const ZOOMED_PER_BOX: RangeInclusive<f64> = 0.5..=2.5;

/// Looks at one box. From the second one on a look is followed by another only where its keypoints lie elsewhere than it
/// was cut for, as happens where the object is half hidden.
const MAX_LOOKS: usize = 4;

/// By how much the size and the centre of two places differ, of their size, for the second to be elsewhere.
const ELSEWHERE: f64 = 0.03;

/// The same for an object that was expected: one look is enough for it, unless it was not where it should be.
const FAR_ELSEWHERE: f64 = 0.12;

/// A place in an image and the crops cut around it, for one object's network.
pub(super) struct Crops<'a> {
    image: &'a RgbImage,
    place: Square,
    /// Whether the place is that of a closer look already.
    expected: bool,
    resampled: Vec<Resampled>,
}

/// Cuts the crops of one box for a first look: those of the ensemble, or one if there will be a second look.
pub(super) fn cut<'a>(
    manifest: &KeypointManifest,
    resizer: &mut Resizer,
    image: &'a RgbImage,
    region: BoundingBox,
) -> Result<Crops<'a>, ResampleError> {
    let variants =
        if manifest.second_look.is_some() { &[CropVariant::PLAIN] } else { manifest.crop_ensemble.as_slice() };
    cut_all(manifest, resizer, image, Square::around(&region), variants)
}

/// Cuts the one crop of an object that is expected at a place, as a closer look would.
pub(super) fn cut_expected<'a>(
    manifest: &KeypointManifest,
    resizer: &mut Resizer,
    image: &'a RgbImage,
    place: Square,
) -> Result<Crops<'a>, ResampleError> {
    let crops = cut_all(manifest, resizer, image, place, &[CropVariant::PLAIN])?;
    Ok(Crops { expected: true, ..crops })
}

fn cut_all<'a>(
    manifest: &KeypointManifest,
    resizer: &mut Resizer,
    image: &'a RgbImage,
    place: Square,
    variants: &[CropVariant],
) -> Result<Crops<'a>, ResampleError> {
    let whole = place.scaled(manifest.crop_scale);
    let square = |variant: &CropVariant| whole.scaled(variant.scale).turned(variant.turn_deg.to_radians());
    let squares: Vec<Square> = variants.iter().map(square).collect();
    let resampled = crop_squares(resizer, image, &squares, manifest.input.size)?;
    Ok(Crops { image, place, expected: false, resampled })
}

/// Runs a network on as many crops as it ever gets at once, and on those of one box.
pub(super) fn warm_up(
    manifest: &KeypointManifest,
    network: &mut KeypointNet,
    resizer: &mut Resizer,
    image: &RgbImage,
    region: BoundingBox,
) -> Result<(), EstimateError> {
    let place = Square::around(&region);
    for count in [MAX_BATCH, manifest.crop_ensemble.len(), 1] {
        let variants: Vec<CropVariant> = manifest.crop_ensemble.iter().copied().cycle().take(count).collect();
        let crops = cut_all(manifest, resizer, image, place, &variants)?;
        predict(manifest, network, &[crops])?;
    }
    Ok(())
}

/// The keypoints within many boxes, in a few runs of the network: `crops` are their first look, [`cut`].
pub(super) fn locate(
    manifest: &KeypointManifest,
    network: &mut KeypointNet,
    resizer: &mut Resizer,
    crops: &[Crops<'_>],
) -> Result<Vec<KeypointPrediction>, EstimateError> {
    let mut found = predict(manifest, network, crops)?;
    let Some(closer_look) = &manifest.second_look else { return Ok(found) };
    let keypoints = manifest.keypoints();
    let mut looked: Vec<(usize, Square)> = crops.iter().map(|first| first.place).enumerate().collect();
    for look in 1..MAX_LOOKS {
        let again = |(at, place): (usize, Square)| {
            let next = zoomed(&found[at], &keypoints, &crops[at].place, closer_look)?;
            let is_wanted = if crops[at].expected {
                look == 1 && elsewhere(&next, &place, FAR_ELSEWHERE)
            } else {
                look == 1 || elsewhere(&next, &place, ELSEWHERE)
            };
            is_wanted.then_some((at, next))
        };
        looked = looked.into_iter().filter_map(again).collect();
        if looked.is_empty() {
            break;
        }
        let cut = |(at, place): &(usize, Square)| {
            let variants = if crops[*at].expected { &[CropVariant::PLAIN] } else { manifest.crop_ensemble.as_slice() };
            cut_all(manifest, resizer, crops[*at].image, *place, variants)
        };
        let closer = looked.iter().map(cut).collect::<Result<Vec<_>, _>>()?;
        for ((at, _), prediction) in looked.iter().zip(predict(manifest, network, &closer)?) {
            found[*at] = prediction;
        }
        for (at, place) in &looked {
            let next = zoomed(&found[*at], &keypoints, &crops[*at].place, closer_look);
            found[*at].spread.moved = Some(next.map_or(1.0, |next| apart(&next, place)));
        }
    }
    Ok(found)
}

/// Where to look closer. `None` where that is no place for the object of this box.
fn zoomed(
    prediction: &KeypointPrediction,
    keypoints: &[Vector3<f64>],
    first: &Square,
    look: &SecondLook,
) -> Option<Square> {
    let next = closer(&prediction.pixels, keypoints, look);
    let near = (next.centre - first.centre).amax() <= first.side;
    (near && ZOOMED_PER_BOX.contains(&(next.side / first.side))).then_some(next)
}

/// The place of a closer look at keypoints that are at these pixels: about their centre, as large as they are spread, and
/// so that the axis points up that the look is for.
pub(super) fn closer(
    pixels: &[Vector2<f64>],
    keypoints: &[Vector3<f64>],
    SecondLook { zoom, up }: &SecondLook,
) -> Square {
    let up = Vector3::from(*up);
    let (centre, spread) = spread_of(pixels);
    let side = zoom * spread;
    let arms = pixels.iter().map(|pixel| pixel - centre);
    let axis: Vector2<f64> = arms.zip(keypoints).map(|(arm, point)| arm * point.dot(&up)).sum();
    Square { centre, side, turn: f64::atan2(-axis.x, -axis.y) }
}

fn elsewhere(next: &Square, place: &Square, by: f64) -> bool {
    apart(next, place) > by
}

/// How far two places differ in centre and size, of their size.
fn apart(next: &Square, place: &Square) -> f64 {
    let moved = (next.centre - place.centre).amax() / place.side;
    moved.max((next.side / place.side).ln().abs())
}

/// The keypoints of many boxes by their crops.
fn predict(
    manifest: &KeypointManifest,
    network: &mut KeypointNet,
    boxes: &[Crops<'_>],
) -> Result<Vec<KeypointPrediction>, RuntimeError> {
    let crops: Vec<&Resampled> = boxes.iter().flat_map(|of_box| &of_box.resampled).collect();
    let mut of_crops = Vec::with_capacity(crops.len());
    for batch in crops.chunks(MAX_BATCH) {
        let rgb = batch.iter().map(|crop| crop.rgb.as_slice()).collect::<Vec<_>>().concat();
        let raw = raw_keypoints(manifest, network, &rgb, batch.len())?;
        of_crops.extend(batch.iter().zip(raw).map(|(crop, raw)| {
            let image_from_crop = crop.crop_from_image.inverse();
            in_image(&image_from_crop, raw, &manifest.covariance_scale)
        }));
    }
    let mut rest = of_crops.as_slice();
    let next = |crops: &Crops<'_>| {
        let (of_box, others) = rest.split_at(crops.resampled.len());
        rest = others;
        combined(of_box, crops.place.side)
    };
    Ok(boxes.iter().map(next).collect())
}

/// The pose of keypoints that were found within a box that is certain, `camera_from_keypoints`, with the covariance that
/// the evidence leaves.
pub(super) fn solve_judged(
    manifest: &KeypointManifest,
    found: &KeypointPrediction,
    image: &RgbImage,
    region: &BoundingBox,
    camera: &Camera,
) -> Result<Solution, PnpError> {
    let Solved { mut solution, .. } = second_peaks::solve(manifest, found, camera, 1.0)?;
    let certain = Detection { object: 0, bounding_box: *region, score: 1.0, given: None };
    solution.covariance = evidence::judge(manifest, &certain, found, &solution, image, camera).covariance(&solution);
    Ok(solution)
}

/// The keypoints within one box of an image.
pub(super) fn locate_within(
    manifest: &KeypointManifest,
    network: &mut KeypointNet,
    resizer: &mut Resizer,
    image: &RgbImage,
    region: &BoundingBox,
) -> Result<KeypointPrediction, EstimateError> {
    let crops = cut(manifest, resizer, image, *region)?;
    // One box, one prediction.
    Ok(locate(manifest, network, resizer, &[crops])?.swap_remove(0))
}
