//! What a keypoint net says of crops, as its manifest states.

use std::ops::Range;

use nalgebra::{Matrix2, Vector2};

use super::answer::{KeypointPrediction, SecondPeaks, Spread};
use super::feed;
use crate::model::{KeypointManifest, KeypointNet, KeypointOutput, Network, Outputs, RuntimeError};
use crate::vision::find_peak;
use posed_core::geometry::Affine;

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
    let output = |name: &str, shape: &[usize]| -> Result<&[f32], RuntimeError> {
        let output = outputs.named(name)?;
        if output.shape != shape {
            return Err(outputs.error(name, format!("has shape {:?}, expected {shape:?}", output.shape)));
        }
        Ok(&output.values)
    };
    let keypoints = output("keypoints", &[crops, count, 2])?;
    let covariances = output("covariances", &[crops, count, 2, 2])?;
    let peaks = output("peaks", &[crops, count])?;
    // Networks that were exported before there were second peaks have none.
    let second = if outputs.has("second_keypoints") || outputs.has("second_weights") {
        Some((output("second_keypoints", &[crops, count, 2])?, output("second_weights", &[crops, count])?))
    } else {
        None
    };
    let unfamiliarity = outputs.has("unfamiliarity").then(|| output("unfamiliarity", &[crops])).transpose()?;
    let rows = |row: usize, width: usize| -> Range<usize> { row * count * width..(row + 1) * count * width };
    let pixels = |uv: &[f32]| uv.chunks_exact(2).map(|uv| Vector2::new(uv[0], uv[1]).cast()).collect();
    let numbers = |values: &[f32]| values.iter().map(|value| f64::from(*value)).collect();
    let of_crop = |row: usize| KeypointPrediction {
        pixels: pixels(&keypoints[rows(row, 2)]),
        covariances: covariances[rows(row, 4)].chunks_exact(4).map(|c| Matrix2::from_row_slice(c).cast()).collect(),
        peaks: numbers(&peaks[rows(row, 1)]),
        second: second.map(|(at, weights)| SecondPeaks {
            pixels: pixels(&at[rows(row, 2)]),
            weights: numbers(&weights[rows(row, 1)]),
        }),
        unfamiliarity: unfamiliarity.map(|values| values[row].into()),
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
        let mut raw = KeypointPrediction::default();
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
pub(super) fn in_image(
    image_from_crop: &Affine,
    mut raw: KeypointPrediction,
    covariance_scale: &[f64],
) -> KeypointPrediction {
    for pixel in raw.pixels.iter_mut().chain(raw.second.iter_mut().flat_map(|second| &mut second.pixels)) {
        *pixel = image_from_crop.apply(pixel);
    }
    for (covariance, scale) in raw.covariances.iter_mut().zip(covariance_scale) {
        *covariance = image_from_crop.apply_to_covariance(&(*covariance * *scale));
    }
    raw
}
