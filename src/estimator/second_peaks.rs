//! Poses where an image leaves two answers open.
//!
//! A cube whose orange a camera shows as red looks the same from two sides. Its network says so: most heatmaps have two
//! peaks. A single peak of each, whichever is higher, may belong to one pose here and to the other there. So the pose that
//! the first peaks show takes of each keypoint the peak that suits it, and what it leaves is tried as another pose.

use nalgebra::{Matrix2, Vector2, Vector3};
use posed_core::geometry::{Camera, Pose};
use posed_core::pnp::{self, Alternative, Options, PnpError, Solution, Status};
use posed_core::views::Reading;

use super::answer::{KeypointPrediction, SecondPeaks};
use crate::model::KeypointManifest;

/// A second peak with less of the first one's mass is no answer.
const MIN_WEIGHT: f64 = 0.05;
/// A pose of second peaks rests on at least so many of them.
const MIN_SECOND: usize = 5;

/// A pose, and whether second peaks show another one.
pub(super) struct Solved {
    pub solution: Solution,
    pub has_rival: bool,
    /// The peaks that the pose rests on; and those of the first alternative, where these are others.
    pub readings: Vec<Reading>,
}

/// The pose of the keypoints as large as a reference says, `camera_from_keypoints`. Where second peaks show another one that
/// is worth a thought, the first of the solution's alternatives is that, and the weights are the shares of the peaks' mass.
pub(super) fn solve(
    manifest: &KeypointManifest,
    prediction: &KeypointPrediction,
    camera: &Camera,
    keypoints_scale: f64,
) -> Result<Solved, PnpError> {
    let points = manifest.keypoints_scaled_by(keypoints_scale);
    let options = Options::default();
    let both =
        |second: &&SecondPeaks| second.weights.iter().filter(|weight| **weight >= MIN_WEIGHT).count() >= MIN_SECOND;
    let Some(second) = prediction.second.as_ref().filter(both) else {
        let solution = pnp::solve(&points, &prediction.pixels, &prediction.covariances, camera, &options)?;
        return Ok(Solved { solution, has_rival: false, readings: vec![first_reading(prediction)] });
    };
    let covariances = of_single_peaks(prediction, second, &manifest.covariance_scale);
    let solve =
        |choice: &Choice| pnp::solve(&points, &choice.pixels(prediction, second), &covariances, camera, &options);
    let suiting = |pose: &Pose| Choice::suiting(pose, &points, prediction, second, camera);
    let first = solve(&Choice(vec![false; points.len()]))?;
    let choice = suiting(&first.pose);
    let own = if choice.is_first() { first } else { solve(&choice)? };
    let reading =
        |choice: &Choice| Reading { pixels: choice.pixels(prediction, second), covariances_px: covariances.clone() };
    let choice = suiting(&own.pose);
    let single = |solution| Solved { solution, has_rival: false, readings: vec![reading(&choice)] };
    let Ok(rival) = solve(&choice.other(second)) else { return Ok(single(own)) };
    let rival_choice = suiting(&rival.pose);
    if rival.doubts.few_inliers || rival_choice.differing(&choice) < MIN_SECOND {
        return Ok(single(own));
    }
    let masses = [choice.mass(&own, second), rival_choice.mass(&rival, second)];
    let share = masses[1] / (masses[0] + masses[1]);
    let own = (own, reading(&choice));
    let rival = (rival, reading(&rival_choice));
    let ((better, of_better), (worse, of_worse), share) =
        if share > 0.5 { (rival, own, 1.0 - share) } else { (own, rival, share) };
    let has_rival = share > options.max_alternative_weight;
    let solution = with_rival(better, &worse, share, has_rival);
    Ok(Solved { solution, has_rival, readings: vec![of_better, of_worse] })
}

/// The first peaks.
pub(super) fn first_reading(prediction: &KeypointPrediction) -> Reading {
    Reading { pixels: prediction.pixels.clone(), covariances_px: prediction.covariances.clone() }
}

fn with_rival(mut better: Solution, worse: &Solution, share: f64, has_rival: bool) -> Solution {
    let left = |alternative: Alternative| Alternative { weight: alternative.weight * (1.0 - share), ..alternative };
    better.weight *= 1.0 - share;
    better.alternatives = [
        Some(Alternative { pose: worse.pose, covariance: worse.covariance, weight: share * worse.weight }),
        better.alternatives[0].map(left),
    ];
    if has_rival {
        better.status = better.status.max(Status::Ambiguous);
    }
    better
}

/// Of which keypoints the second peak is taken.
struct Choice(Vec<bool>);

impl Choice {
    /// Of each keypoint the peak that is nearer to where a pose puts it.
    fn suiting(
        pose: &Pose,
        points: &[Vector3<f64>],
        prediction: &KeypointPrediction,
        second: &SecondPeaks,
        camera: &Camera,
    ) -> Self {
        let is_second = |k: usize| {
            let Ok(expected) = camera.project(&pose.transform(&points[k])) else { return false };
            let far = |pixel: &Vector2<f64>| (pixel - expected).norm_squared();
            second.weights[k] >= MIN_WEIGHT && far(&second.pixels[k]) < far(&prediction.pixels[k])
        };
        Self((0..points.len()).map(is_second).collect())
    }

    fn is_first(&self) -> bool {
        !self.0.contains(&true)
    }

    /// Where there are two peaks, those that this choice leaves.
    fn other(&self, second: &SecondPeaks) -> Self {
        Self(self.0.iter().zip(&second.weights).map(|(taken, weight)| *weight >= MIN_WEIGHT && !taken).collect())
    }

    fn differing(&self, other: &Self) -> usize {
        self.0.iter().zip(&other.0).filter(|(a, b)| a != b).count()
    }

    fn pixels(&self, prediction: &KeypointPrediction, second: &SecondPeaks) -> Vec<Vector2<f64>> {
        let peaks = prediction.pixels.iter().zip(&second.pixels).zip(&self.0);
        peaks.map(|((first, second), is_second)| if *is_second { *second } else { *first }).collect()
    }

    /// Mean share of the peaks' mass that agrees with a pose.
    fn mass(&self, of: &Solution, second: &SecondPeaks) -> f64 {
        let share = |k: usize| {
            let weight = second.weights[k];
            let chosen = if self.0[k] { weight } else { 1.0 };
            if of.residuals()[k].inlier { chosen / (1.0 + weight) } else { 0.0 }
        };
        (0..self.0.len()).map(share).sum::<f64>() / self.0.len() as f64
    }
}

/// The covariances of single peaks, px². Those of a heatmap with two span both: `(1 - p) C + p (C + d dᵀ)` for a second peak at
/// a distance `d` with a share `p` of the mass, all times the factor that held-out images showed. Across `d` there is nothing to
/// take away, and along it no peak is taken to be sharper than across.
fn of_single_peaks(prediction: &KeypointPrediction, second: &SecondPeaks, scale: &[f64]) -> Vec<Matrix2<f64>> {
    let single = |k: usize| {
        let (covariance, weight) = (prediction.covariances[k], second.weights[k]);
        let apart = second.pixels[k] - prediction.pixels[k];
        let Some(along) = apart.try_normalize(f64::EPSILON).filter(|_| weight >= MIN_WEIGHT) else { return covariance };
        let across = Vector2::new(-along.y, along.x);
        let variance = |axis: &Vector2<f64>| axis.dot(&(covariance * axis));
        let spanned = scale[k] * weight / (1.0 + weight) * apart.norm_squared();
        let least = variance(&across);
        let left = (variance(&along) - spanned).max(least);
        along * along.transpose() * left + across * across.transpose() * least
    };
    (0..prediction.pixels.len()).map(single).collect()
}
