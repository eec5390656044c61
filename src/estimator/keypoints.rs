//! Crops through a keypoint net, and back to image pixels.

use std::ops::{Range, RangeInclusive};

use fast_image_resize::Resizer;
use image::RgbImage;
use nalgebra::{Matrix2, Vector2, Vector3};

use super::answer::{Detection, EstimateError, KeypointPrediction, Spread};
use super::evidence;
use super::feed;
use crate::model::{
    CropVariant, KeypointManifest, KeypointNet, KeypointOutput, Network, Outputs, RuntimeError, SecondLook,
};
use crate::vision::{BoundingBox, ResampleError, Resampled, Square, crop_squares, find_peak};
use posed_core::geometry::{Affine, Camera};
use posed_core::pnp::{self, PnpError, Solution};

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

/// Mean distance of two crops' keypoints, of the side of their place. One crop of a symmetric object may show other
/// keypoints than the next, and be as right; their mean is not.
const MAX_DISAGREEMENT: f64 = 0.1;

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
        // A crop with values that are no numbers is nobody's company.
        let sound: Vec<&KeypointPrediction> = of_box.iter().filter(|crop| crop.is_finite()).collect();
        match &sound[..] {
            [] => of_box[0].clone(),
            sound => {
                let agreeing = largest_agreement(sound, MAX_DISAGREEMENT * crops.place.side);
                let left_out = 1.0 - agreeing.len() as f64 / of_box.len() as f64;
                let mean = average(&agreeing);
                let several = (of_box.len() > 1).then(|| spread(&agreeing, &mean, crops.place.side));
                let spread = Spread { left_out, ..several.unwrap_or_default() };
                KeypointPrediction { spread, ..mean }
            }
        }
    };
    Ok(boxes.iter().map(next).collect())
}

/// What the network says of each crop, in crop pixels and with its own covariances. `rgb` holds the crops, one after
/// another. A network that fails on several but on none of them alone gets them one at a time from then on.
pub(super) fn raw_keypoints(
    manifest: &KeypointManifest,
    net: &mut KeypointNet,
    rgb: &[u8],
    crops: usize,
) -> Result<Vec<KeypointPrediction>, RuntimeError> {
    let several = if crops == 1 || !net.one_by_one {
        match keypoints_of(manifest, net.network.as_mut(), rgb, crops) {
            Err(error) if crops > 1 => Some(error),
            result => return result,
        }
    } else {
        None
    };
    let one = |crop: &[u8]| keypoints_of(manifest, net.network.as_mut(), crop, 1);
    let found = rgb.chunks_exact(rgb.len() / crops).map(one).collect::<Result<Vec<_>, _>>()?;
    if let Some(error) = several {
        tracing::warn!(%error, "the keypoint net of {} takes one crop at a time", manifest.name);
        net.one_by_one = true;
    }
    Ok(found.concat())
}

fn keypoints_of(
    manifest: &KeypointManifest,
    network: &mut dyn Network,
    rgb: &[u8],
    crops: usize,
) -> Result<Vec<KeypointPrediction>, RuntimeError> {
    let side = manifest.input.size as usize;
    let outputs = feed::run(network, &manifest.input.pixels(), rgb, [side, side])?;
    match manifest.output {
        KeypointOutput::Keypoints => decoded(manifest, &outputs, crops),
        KeypointOutput::Heatmaps => from_heatmaps(manifest, &outputs, crops),
    }
}

fn decoded(
    manifest: &KeypointManifest,
    outputs: &Outputs,
    crops: usize,
) -> Result<Vec<KeypointPrediction>, RuntimeError> {
    let count = manifest.virtual_keypoints_m.len();
    let expected = [
        ("keypoints", vec![crops, count, 2]),
        ("covariances", vec![crops, count, 2, 2]),
        ("peaks", vec![crops, count]),
    ];
    let mut values: [&[f32]; 3] = [&[]; 3];
    for (slot, (name, shape)) in values.iter_mut().zip(&expected) {
        let output = outputs.named(name)?;
        if &output.shape != shape {
            return Err(outputs.error(name, format!("has shape {:?}, expected {shape:?}", output.shape)));
        }
        *slot = &output.values;
    }
    let [keypoints, covariances, peaks] = values;
    let rows = |row: usize, width: usize| -> Range<usize> { row * count * width..(row + 1) * count * width };
    let of_crop = |row: usize| KeypointPrediction {
        pixels: keypoints[rows(row, 2)].chunks_exact(2).map(|uv| Vector2::new(uv[0], uv[1]).cast()).collect(),
        covariances: covariances[rows(row, 4)].chunks_exact(4).map(|c| Matrix2::from_row_slice(c).cast()).collect(),
        peaks: peaks[rows(row, 1)].iter().map(|peak| f64::from(*peak)).collect(),
        spread: Spread::default(),
    };
    Ok((0..crops).map(of_crop).collect())
}

fn from_heatmaps(
    manifest: &KeypointManifest,
    outputs: &Outputs,
    crops: usize,
) -> Result<Vec<KeypointPrediction>, RuntimeError> {
    let output = outputs.first()?;
    let count = manifest.virtual_keypoints_m.len();
    let side = match output.shape[..] {
        [b, n, rows, columns] if b == crops && n == count && rows == columns && rows > 0 => rows,
        _ => {
            let problem = format!("has shape {:?}, expected [{crops}, {count}, side, side]", output.shape);
            return Err(outputs.error(&output.name, problem));
        }
    };
    let of_crop = |maps: &[f32]| {
        let (pixels, covariances, peaks) = (Vec::new(), Vec::new(), Vec::new());
        let mut raw = KeypointPrediction { pixels, covariances, peaks, spread: Spread::default() };
        for peak in maps.chunks_exact(side * side).map(|map| find_peak(map, side, f64::from(manifest.input.size))) {
            raw.pixels.push(peak.position);
            raw.covariances.push(peak.covariance);
            raw.peaks.push(peak.mass);
        }
        raw
    };
    Ok(output.values.chunks_exact(count * side * side).map(of_crop).collect())
}

/// Maps one crop's keypoints to image pixels, and scales their covariances by what held-out images showed.
fn in_image(image_from_crop: &Affine, mut raw: KeypointPrediction, covariance_scale: &[f64]) -> KeypointPrediction {
    for pixel in &mut raw.pixels {
        *pixel = image_from_crop.apply(pixel);
    }
    for (covariance, scale) in raw.covariances.iter_mut().zip(covariance_scale) {
        *covariance = image_from_crop.apply_to_covariance(&(*covariance * *scale));
    }
    raw
}

/// Those crops whose keypoints lie about where those of some crop do: of the crop with most company, the first of them.
fn largest_agreement<'a>(of_crops: &[&'a KeypointPrediction], within: f64) -> Vec<&'a KeypointPrediction> {
    let company = |crop: &KeypointPrediction| -> Vec<&KeypointPrediction> {
        of_crops.iter().filter(|other| mean_distance(crop, other) <= within).copied().collect()
    };
    let mut largest = Vec::new();
    for candidate in of_crops.iter().map(|crop| company(crop)) {
        if candidate.len() > largest.len() {
            largest = candidate;
        }
    }
    largest
}

fn mean_distance(a: &KeypointPrediction, b: &KeypointPrediction) -> f64 {
    let apart: f64 = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (a - b).norm()).sum();
    apart / a.pixels.len() as f64
}

/// The mean over the crops of one box. Covariances are averaged, not reduced: the crops show the same pixels, and what
/// averaging gains is part of the factors fitted on held-out images.
fn average(of_crops: &[&KeypointPrediction]) -> KeypointPrediction {
    let share = (of_crops.len() as f64).recip();
    let count = of_crops[0].pixels.len();
    let mut mean = KeypointPrediction {
        pixels: vec![Vector2::zeros(); count],
        covariances: vec![Matrix2::zeros(); count],
        peaks: vec![0.0; count],
        spread: Spread::default(),
    };
    for crop in of_crops {
        for k in 0..count {
            mean.pixels[k] += crop.pixels[k] * share;
            mean.covariances[k] += crop.covariances[k] * share;
            mean.peaks[k] += crop.peaks[k] * share;
        }
    }
    mean
}

/// How far crops lie from their mean.
fn spread(of_crops: &[&KeypointPrediction], mean: &KeypointPrediction, side: f64) -> Spread {
    let share = (of_crops.len() as f64).recip();
    let squares = |crop: &KeypointPrediction| -> f64 {
        let apart = crop.pixels.iter().zip(&mean.pixels).map(|(a, b)| (a - b).norm_squared());
        apart.sum::<f64>() / mean.pixels.len() as f64
    };
    let apart = (of_crops.iter().map(|crop| squares(crop)).sum::<f64>() * share).sqrt() / side;
    let sizes = || of_crops.iter().map(|crop| spread_of(&crop.pixels).1.ln());
    let middle = sizes().sum::<f64>() * share;
    let scale = (sizes().map(|size| (size - middle).powi(2)).sum::<f64>() * share).sqrt();
    Spread { apart: Some(apart), scale: Some(scale), ..Spread::default() }
}

/// The keypoints' centre, and their root mean square distance from it.
fn spread_of(pixels: &[Vector2<f64>]) -> (Vector2<f64>, f64) {
    let share = (pixels.len() as f64).recip();
    let centre = pixels.iter().sum::<Vector2<f64>>() * share;
    let squares: f64 = pixels.iter().map(|pixel| (pixel - centre).norm_squared()).sum();
    (centre, (squares * share).sqrt())
}

/// The pose of the scaled keypoints, `camera_from_keypoints`.
pub(super) fn solve(
    manifest: &KeypointManifest,
    prediction: &KeypointPrediction,
    camera: &Camera,
    keypoints_scale: f64,
) -> Result<Solution, PnpError> {
    let points = manifest.keypoints_scaled_by(keypoints_scale);
    pnp::solve(&points, &prediction.pixels, &prediction.covariances, camera, &pnp::Options::default())
}

/// The keypoints' pose, `camera_from_keypoints`, within one box of an image.
pub(super) fn solve_within(
    manifest: &KeypointManifest,
    network: &mut KeypointNet,
    resizer: &mut Resizer,
    image: &RgbImage,
    region: &BoundingBox,
    camera: &Camera,
) -> Result<Result<Solution, PnpError>, EstimateError> {
    let camera = camera.for_image(image.width(), image.height())?;
    let found = locate_within(manifest, network, resizer, image, region)?;
    let certain = Detection { object: 0, bounding_box: *region, score: 1.0 };
    Ok(solve(manifest, &found, &camera, 1.0).map(|mut solution| {
        evidence::judge(manifest, &certain, &found, &mut solution, image, &camera);
        solution
    }))
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
