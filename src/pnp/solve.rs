use nalgebra::{Matrix2, Vector2, Vector3};

use super::p3p;
use super::problem::{MAX_POINTS, PnpError, Problem};
use super::refine::{Refined, normal_equations, refine};
use super::solution::{Alternative, Reason, Solution, Status};
use crate::geometry::{Camera, Covariance6, Pose};

/// 99 % of the squared Mahalanobis distances of true 2D points lie below this (chi-squared, 2 degrees of freedom).
const INLIER_THRESHOLD: f64 = 9.21;
const MAX_MODES: usize = 3;
/// Candidates are held until refinement; more than the modes kept, because several lead to one mode.
const MAX_CANDIDATES: usize = 6;
/// Poses closer than this are one mode.
const MODE_SEPARATION_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// What a pose must fulfil to be called good.
#[derive(Clone, Debug)]
pub struct Options {
    /// Standard deviation added to every keypoint, pixels of the image: no net is better than this.
    pub floor_px: f64,
    /// Fewer agreeing points than this make a pose `low_confidence`; fewer than 4 make it `rejected`.
    pub min_inliers: usize,
    /// `chi2 / degrees_of_freedom` above this makes a pose `low_confidence`.
    pub max_reduced_chi2: f64,
    /// Weight of a second mode above which a pose is `ambiguous`.
    pub max_alternative_weight: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { floor_px: 0.3, min_inliers: 5, max_reduced_chi2: 4.0, max_alternative_weight: 0.05 }
    }
}

/// Solves `camera_from_points` from 4 to 16 points (metres), their pixels and the pixels' 2x2 covariances (px²).
///
/// The pixels belong to the image that `camera` belongs to. Up to two alternatives come with the pose: modes at least
/// 15 degrees apart, weighted by `exp(-cost / 2) sqrt(det covariance)` (Laplace's approximation of their posterior).
///
/// # Errors
/// [`PnpError`] names the input that is unusable, or says that no pose fits.
pub fn solve(
    points: &[Vector3<f64>],
    pixels: &[Vector2<f64>],
    covariances_px: &[Matrix2<f64>],
    camera: &Camera,
    options: &Options,
) -> Result<Solution, PnpError> {
    let problem = Problem::new(points, pixels, covariances_px, camera, options.floor_px)?;
    let mut candidates = Ranking::<MAX_CANDIDATES>::default();
    for (a, b, c) in triplets(problem.len()) {
        let [points, rays] = [[a, b, c].map(|k| problem.point(k)), [a, b, c].map(|k| problem.ray(k))];
        p3p::solve(points, rays, |pose| {
            if let Some(cost) = truncated_cost(&problem, &pose, candidates.worst()) {
                candidates.insert(pose, cost);
            }
        });
    }
    let mut modes = Ranking::<MAX_MODES>::default();
    for candidate in candidates.iter() {
        if let Some(Refined { pose, cost }) = refine(&problem, &candidate.pose) {
            modes.insert(pose, cost);
        }
    }
    assemble(&problem, &modes)
}

/// Every choice of three of `n` points.
fn triplets(n: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..n).flat_map(move |a| (a + 1..n).flat_map(move |b| (b + 1..n).map(move |c| (a, b, c))))
}

/// MSAC: squared Mahalanobis distances, each cut off at the inlier threshold. `None` as soon as the sum passes `limit`.
fn truncated_cost(problem: &Problem, pose: &Pose, limit: f64) -> Option<f64> {
    let mut cost = 0.0;
    for index in 0..problem.len() {
        cost += problem.mahalanobis_squared(index, pose).min(INLIER_THRESHOLD);
        if cost >= limit {
            return None;
        }
    }
    Some(cost)
}

#[derive(Clone, Copy, Debug)]
struct Ranked {
    pose: Pose,
    cost: f64,
}

/// The best `K` poses that are distinct modes, best first.
struct Ranking<const K: usize> {
    entries: [Option<Ranked>; K],
}

impl<const K: usize> Default for Ranking<K> {
    fn default() -> Self {
        Self { entries: [None; K] }
    }
}

impl<const K: usize> Ranking<K> {
    fn iter(&self) -> impl Iterator<Item = &Ranked> {
        self.entries.iter().flatten()
    }

    /// A pose must cost less than this to enter.
    fn worst(&self) -> f64 {
        self.entries[K - 1].map_or(f64::INFINITY, |entry| entry.cost)
    }

    fn insert(&mut self, pose: Pose, cost: f64) {
        let same_mode = |entry: &Ranked| entry.pose.angle_to(&pose) < MODE_SEPARATION_RAD;
        if self.iter().any(|entry| same_mode(entry) && entry.cost <= cost) {
            return;
        }
        let mut kept = [None; K];
        let mut next = 0;
        let mut pending = Some(Ranked { pose, cost });
        for entry in self.entries.into_iter().flatten() {
            if pending.is_some_and(|new| new.cost < entry.cost) && next < K {
                kept[next] = pending.take();
                next += 1;
            }
            if next < K && !same_mode(&entry) {
                kept[next] = Some(entry);
                next += 1;
            }
        }
        if next < K && pending.is_some() {
            kept[next] = pending;
        }
        self.entries = kept;
    }
}

fn assemble(problem: &Problem, modes: &Ranking<MAX_MODES>) -> Result<Solution, PnpError> {
    let best = modes.entries[0].ok_or(PnpError::NoPose)?;
    let mut inliers = [false; MAX_POINTS];
    let mut chi2 = 0.0;
    for (index, inlier) in inliers.iter_mut().enumerate().take(problem.len()) {
        let squared = problem.mahalanobis_squared(index, &best.pose);
        if squared < INLIER_THRESHOLD {
            *inlier = true;
            chi2 += squared;
        }
    }
    let weights = mode_weights(problem, modes);
    let mut alternatives = [None; 2];
    for (slot, (entry, weight)) in alternatives.iter_mut().zip(modes.entries.iter().zip(weights).skip(1)) {
        *slot = entry.map(|mode| Alternative { pose: mode.pose, weight });
    }
    let degrees_of_freedom = (2 * inliers.iter().filter(|inlier| **inlier).count()).saturating_sub(6);
    let inflation = (chi2 / degrees_of_freedom.max(1) as f64).max(1.0);
    let covariance = covariance_over_inliers(problem, &best.pose).ok_or(PnpError::NoPose)? * inflation;
    Ok(Solution {
        pose: best.pose,
        covariance,
        chi2,
        degrees_of_freedom,
        inliers,
        points: problem.len(),
        weight: weights[0],
        alternatives,
    })
}

/// Inverse Gauss-Newton Hessian over the inliers; over all points where the inliers alone do not fix a pose.
fn covariance_over_inliers(problem: &Problem, pose: &Pose) -> Option<Covariance6> {
    let inverse = |limit: f64| {
        let (hessian, _) = normal_equations(problem, pose, |squared| f64::from(u8::from(squared < limit)))?;
        let inverse = hessian.cholesky()?.inverse();
        inverse.iter().all(|v| v.is_finite()).then_some(inverse)
    };
    inverse(INLIER_THRESHOLD).or_else(|| inverse(f64::INFINITY))
}

fn mode_weights(problem: &Problem, modes: &Ranking<MAX_MODES>) -> [f64; MAX_MODES] {
    let lowest = modes.entries[0].map_or(0.0, |mode| mode.cost);
    let mut weights = [0.0; MAX_MODES];
    for (weight, mode) in weights.iter_mut().zip(modes.iter()) {
        let spread = covariance_over_inliers(problem, &mode.pose).map_or(0.0, |c| c.determinant().max(0.0).sqrt());
        *weight = (-0.5 * (mode.cost - lowest)).exp() * spread;
    }
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 { weights.map(|weight| weight / sum) } else { [1.0, 0.0, 0.0] }
}

impl Solution {
    /// Judges the pose. Callers add what they know beyond the points.
    #[must_use]
    pub fn judge(&self, options: &Options) -> (Status, Vec<Reason>) {
        let mut reasons = Vec::new();
        let mut status = Status::Ok;
        if self.alternatives.iter().flatten().any(|a| a.weight > options.max_alternative_weight) {
            reasons.push(Reason::PlanarAmbiguity);
            status = Status::Ambiguous;
        }
        let reduced_chi2 = self.chi2 / self.degrees_of_freedom.max(1) as f64;
        if reduced_chi2 > options.max_reduced_chi2 {
            reasons.push(Reason::HighResidual);
            status = status.max(Status::LowConfidence);
        }
        if self.inlier_count() < options.min_inliers {
            reasons.push(Reason::FewInliers);
            status = status.max(if self.inlier_count() < 4 { Status::Rejected } else { Status::LowConfidence });
        }
        (status, reasons)
    }
}
