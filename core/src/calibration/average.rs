//! One offset from those of several reference images (paper, appendix "Average Offset Transformation").

use nalgebra::{Matrix6, Vector3, Vector6};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use thiserror::Error;

use super::offset::Offset;
use crate::geometry::{Pose, parts};

/// How the offsets of several references become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum Mode {
    /// Algorithm 1 of the paper as printed: random single-sample hypotheses, then the geodesic mean of the rotations and
    /// the arithmetic mean of the translations.
    Paper,
    /// The same consensus, with every reference as a hypothesis, then each reference weighted by the inverse covariance
    /// of its pose: depth is the weak axis of every view, and views from other sides know it better.
    #[default]
    Weighted,
}

/// Parameters of Algorithm 1, by their names in the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Consensus {
    /// `t_r`: two offsets agree when their rotations differ by less than this.
    pub rotation_threshold_rad: f64,
    /// `t_t`: ... and their translations by less than this.
    pub translation_threshold_m: f64,
    /// `eta`: probability of having drawn a good hypothesis at which drawing ends.
    pub confidence: f64,
    /// `max_iter`: most hypotheses that are drawn.
    pub max_iterations: u32,
    /// `epsilon`: mean rotation (radians) below which the mean has converged.
    pub tolerance_rad: f64,
    /// `max_step`: most steps towards the mean.
    pub max_steps: u32,
    /// Of the random draws; the same seed gives the same answer.
    pub seed: u64,
}

impl Default for Consensus {
    fn default() -> Self {
        Self {
            rotation_threshold_rad: 10.0_f64.to_radians(),
            translation_threshold_m: 0.03,
            confidence: 0.999,
            max_iterations: 100,
            tolerance_rad: 1e-9,
            max_steps: 50,
            seed: 0,
        }
    }
}

/// References that no offset follows from.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AverageError {
    #[error("no references; give at least one reference image with a known pose")]
    Empty,
    #[error("reference {index} has a value that is not finite")]
    NotFinite { index: usize },
    #[error("covariance of reference {index} is not positive definite")]
    Covariance { index: usize },
    #[error(
        "only {agreeing} of {references} references agree within {:.1} deg and {:.0} mm, but more than half must; \
         check the poses of the references, or leave out the wrong ones",
        .rotation_threshold_rad.to_degrees(), 1e3 * .translation_threshold_m
    )]
    NoConsensus { agreeing: usize, references: usize, rotation_threshold_rad: f64, translation_threshold_m: f64 },
}

/// The offset of several references and how far each of them is from it.
#[derive(Clone, Debug)]
pub struct Averaged {
    /// The common offset, with the covariance that the references leave it.
    pub offset: Offset,
    /// One for each reference.
    pub residuals: Vec<ReferenceResidual>,
}

/// How far one reference's offset is from the common one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceResidual {
    /// Whether the offset rests on this reference.
    pub inlier: bool,
    /// Angle between this reference's offset and the common one.
    pub rotation_rad: f64,
    /// Distance between their translations.
    pub translation_m: f64,
}

/// The common offset of one or more references, each measured by [`Offset::measure`].
///
/// # Errors
/// [`AverageError`] names the unusable reference, or says that the references contradict each other.
pub fn average(references: &[Offset], mode: Mode, consensus: &Consensus) -> Result<Averaged, AverageError> {
    check(references)?;
    let inliers = match mode {
        Mode::Paper => consensus.draw(references),
        Mode::Weighted => consensus.exhaust(references),
    };
    let agreeing = inliers.iter().filter(|inlier| **inlier).count();
    if 2 * agreeing <= references.len() {
        return Err(AverageError::NoConsensus {
            agreeing,
            references: references.len(),
            rotation_threshold_rad: consensus.rotation_threshold_rad,
            translation_threshold_m: consensus.translation_threshold_m,
        });
    }
    let chosen: Vec<&Offset> = references.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|(r, _)| r).collect();
    let offset = match mode {
        Mode::Paper => mean(&chosen, consensus),
        Mode::Weighted => weighted_mean(&chosen, consensus).ok_or(AverageError::Covariance { index: 0 })?,
    };
    let residuals = references
        .iter()
        .zip(inliers)
        .map(|(reference, inlier)| {
            let (rotation_rad, translation_m) =
                distance(&offset.object_from_keypoints, &reference.object_from_keypoints);
            ReferenceResidual { inlier, rotation_rad, translation_m }
        })
        .collect();
    Ok(Averaged { offset, residuals })
}

fn check(references: &[Offset]) -> Result<(), AverageError> {
    if references.is_empty() {
        return Err(AverageError::Empty);
    }
    for (index, reference) in references.iter().enumerate() {
        let pose = reference.object_from_keypoints.matrix();
        if !pose.iter().chain(reference.covariance.iter()).all(|v| v.is_finite()) {
            return Err(AverageError::NotFinite { index });
        }
        if reference.covariance.cholesky().is_none() {
            return Err(AverageError::Covariance { index });
        }
    }
    Ok(())
}

/// Angle (rad) and distance (m) between two offsets.
fn distance(a: &Pose, b: &Pose) -> (f64, f64) {
    (a.angle_to(b), (a.translation() - b.translation()).norm())
}

impl Consensus {
    /// Lines 1 to 16 of Algorithm 1.
    fn draw(&self, references: &[Offset]) -> Vec<bool> {
        let mut rng = SmallRng::seed_from_u64(self.seed);
        let mut best = vec![false; references.len()];
        let mut best_count = 0;
        for iteration in 1..=self.max_iterations.max(1) {
            let drawn = rng.random_range(0..references.len());
            let (agreeing, count) = self.agreeing(references, drawn);
            if best_count < count {
                (best, best_count) = (agreeing, count);
            }
            let ratio = best_count as f64 / references.len() as f64;
            if 1.0 - (1.0 - ratio).powf(f64::from(iteration)) > self.confidence {
                break;
            }
        }
        best
    }

    /// The largest set of references that agree with one of them.
    fn exhaust(&self, references: &[Offset]) -> Vec<bool> {
        let sets = (0..references.len()).map(|index| self.agreeing(references, index));
        // The first of equally large ones.
        sets.reduce(|best, other| if other.1 > best.1 { other } else { best }).map_or_else(Vec::new, |(set, _)| set)
    }

    fn agreeing(&self, references: &[Offset], with: usize) -> (Vec<bool>, usize) {
        let hypothesis = &references[with].object_from_keypoints;
        let agreeing: Vec<bool> = references
            .iter()
            .map(|reference| {
                let (angle, shift) = distance(hypothesis, &reference.object_from_keypoints);
                angle < self.rotation_threshold_rad && shift < self.translation_threshold_m
            })
            .collect();
        let count = agreeing.iter().filter(|agrees| **agrees).count();
        (agreeing, count)
    }
}

/// Lines 17 to 23 of Algorithm 1. The covariance is that of a mean: the sum of all over their number squared.
fn mean(chosen: &[&Offset], consensus: &Consensus) -> Offset {
    let count = chosen.len() as f64;
    let mut pose = chosen[0].object_from_keypoints;
    for _ in 0..consensus.max_steps {
        // Rotations are stepped along the fixed axes of frame object; the mean is the same as with the paper's
        // `R exp(r)`, which steps along the turned ones.
        let turns = chosen.iter().map(|offset| parts(&pose.step_to(&offset.object_from_keypoints)).1);
        let step = turns.sum::<Vector3<f64>>() / count;
        if step.norm() < consensus.tolerance_rad {
            break;
        }
        pose = pose.perturbed(&Vector3::zeros(), &step);
    }
    let translation =
        chosen.iter().map(|offset| offset.object_from_keypoints.translation()).sum::<Vector3<f64>>() / count;
    let covariance = chosen.iter().map(|offset| offset.covariance).sum::<Matrix6<f64>>() / (count * count);
    Offset { object_from_keypoints: Pose::new(*pose.rotation(), translation), covariance, ..*chosen[0] }
}

/// Gauss-Newton on the sum of squared Mahalanobis distances to all offsets.
fn weighted_mean(chosen: &[&Offset], consensus: &Consensus) -> Option<Offset> {
    let informations: Vec<Matrix6<f64>> = chosen
        .iter()
        .map(|offset| offset.covariance.cholesky().map(|factor| factor.inverse()))
        .collect::<Option<_>>()?;
    let total = informations.iter().sum::<Matrix6<f64>>().cholesky()?;
    let mut pose = chosen[0].object_from_keypoints;
    for _ in 0..consensus.max_steps {
        let pulls = chosen.iter().zip(&informations).map(|(o, weight)| weight * pose.step_to(&o.object_from_keypoints));
        let step = total.solve(&pulls.sum::<Vector6<f64>>());
        let (translation, rotation) = parts(&step);
        pose = pose.perturbed(&translation, &rotation);
        if rotation.norm() < consensus.tolerance_rad {
            break;
        }
    }
    let chi2: f64 = chosen
        .iter()
        .zip(&informations)
        .map(|(offset, weight)| {
            let step = pose.step_to(&offset.object_from_keypoints);
            step.dot(&(weight * step))
        })
        .sum();
    // References that scatter more than they admit make the mean less certain.
    let degrees_of_freedom = (6 * (chosen.len() - 1)).max(1) as f64;
    let covariance = total.inverse() * (chi2 / degrees_of_freedom).max(1.0);
    Some(Offset { object_from_keypoints: pose, covariance, ..*chosen[0] })
}
