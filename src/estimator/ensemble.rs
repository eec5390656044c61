//! The crops of one box: which of them agree, their mean, and how far they lie apart.

use nalgebra::{Matrix2, Vector2};

use super::answer::{KeypointPrediction, SecondPeaks, Spread};

/// Mean distance of two crops' keypoints, of the side of their place. One crop of a symmetric object may show other
/// keypoints than the next, and be as right; their mean is not.
const MAX_DISAGREEMENT: f64 = 0.1;

/// What the crops of a box, whose place has this side, say together.
pub(super) fn combined(of_box: &[KeypointPrediction], side: f64) -> KeypointPrediction {
    // A crop with values that are no numbers is nobody's company.
    let sound: Vec<&KeypointPrediction> = of_box.iter().filter(|crop| crop.is_finite()).collect();
    if sound.is_empty() {
        return of_box[0].clone();
    }
    let agreeing = largest_agreement(&sound, MAX_DISAGREEMENT * side);
    let left_out = 1.0 - agreeing.len() as f64 / of_box.len() as f64;
    let mean = average(&agreeing);
    let several = (of_box.len() > 1).then(|| spread(&agreeing, &mean, side));
    KeypointPrediction { spread: Spread { left_out, ..several.unwrap_or_default() }, ..mean }
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
        second: second_of(of_crops),
        unfamiliarity: of_crops.iter().map(|crop| crop.unfamiliarity).sum::<Option<f64>>().map(|sum| sum * share),
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

/// Second peaks come and go from one crop to the next, and may be different ones: of each keypoint the heaviest, with the mean
/// weight.
fn second_of(of_crops: &[&KeypointPrediction]) -> Option<SecondPeaks> {
    let seconds: Vec<&SecondPeaks> = of_crops.iter().map(|crop| crop.second.as_ref()).collect::<Option<_>>()?;
    let count = of_crops[0].pixels.len();
    let heaviest = |k: usize| seconds.iter().max_by(|a, b| a.weights[k].total_cmp(&b.weights[k]));
    Some(SecondPeaks {
        pixels: (0..count).filter_map(|k| heaviest(k).map(|second| second.pixels[k])).collect(),
        weights: (0..count)
            .map(|k| seconds.iter().map(|second| second.weights[k]).sum::<f64>() / seconds.len() as f64)
            .collect(),
    })
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
pub(super) fn spread_of(pixels: &[Vector2<f64>]) -> (Vector2<f64>, f64) {
    let share = (pixels.len() as f64).recip();
    let centre = pixels.iter().sum::<Vector2<f64>>() * share;
    let squares: f64 = pixels.iter().map(|pixel| (pixel - centre).norm_squared()).sum();
    (centre, (squares * share).sqrt())
}
