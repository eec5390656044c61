use nalgebra::{Matrix2, Vector2, Vector3};

use super::hypotheses::{Triplets, mirrored};
use super::modes::{Candidate, Ranking};
use super::problem::{MAX_POINTS, MIN_POINTS, PnpError, Problem, WhitenedPoint};
use super::refine::{Cauchy, Effort, Refined, Truncated, refine};
use super::solution::{Alternative, Doubts, Residual, Solution, Status};
use crate::geometry::{Camera, Covariance6, Pose};

/// 99.9 % of the squared Mahalanobis distances of true 2D points lie below this (chi-squared, 2 degrees of freedom).
/// At 99 % one fit in twelve of eight good points would lose one, and its covariance would be too small.
pub(crate) const INLIER: Truncated = Truncated { limit: 13.82 };
/// The 99 % limit: what a point costs at most while hypotheses are compared, before they are refined.
const MISFIT: f64 = 9.21;
pub(crate) const ROBUST: Cauchy = Cauchy { width: 2.0 };
const MAX_MODES: usize = 3;
/// Candidates are held until refinement; more than the modes kept, because several lead to one mode.
const MAX_CANDIDATES: usize = 6;
/// Triplets tried before the first look at what they give.
const FIRST_TRIPLETS: usize = 10;
/// Tells whether a candidate is worth more.
const GLANCE: Effort = Effort { max_steps: 3, tolerance: 0.01 };
/// To a hundredth of the final standard deviation, from where least squares goes on.
const ROUGH: Effort = Effort { max_steps: 30, tolerance: 1e-4 };
const EXACT: Effort = Effort { max_steps: 30, tolerance: 1e-8 };
/// A candidate that explains two points less than the best is not worth a glance.
const POOR: f64 = 2.0 * MISFIT;
/// A candidate whose robust cost after the first steps is this much above the best is no mode of the posterior.
const HOPELESS: f64 = 40.0;
/// A pose is ambiguous when another costs at most this much more.
const AMBIGUOUS_COST: f64 = 3.0;

/// What a pose must fulfil to be called good, and what is known beforehand.
#[derive(Clone, Debug)]
pub struct Options {
    /// Standard deviation added to every keypoint, pixels of the image: no net is better than this.
    pub floor_px: f64,
    /// Fewer agreeing points than this make a pose `low_confidence`; fewer than 4 make it `rejected`.
    pub min_inliers: usize,
    /// So does a smaller share of the points that were given: a pose that most of them contradict is not trusted.
    pub min_inlier_share: f64,
    /// `chi2 / degrees_of_freedom` above this makes a pose `low_confidence`.
    pub max_reduced_chi2: f64,
    /// Weight of a second mode above which a pose is `ambiguous`.
    pub max_alternative_weight: f64,
    /// `camera_from_points` of the image before, where there is a track: one more place to start from. It has no other
    /// influence on the answer.
    pub previous: Option<Pose>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            floor_px: 0.3,
            min_inliers: 5,
            min_inlier_share: 0.5,
            max_reduced_chi2: 4.0,
            max_alternative_weight: 0.05,
            previous: None,
        }
    }
}

/// Solves `camera_from_points` from 4 to 16 points (metres), their pixels and the pixels' 2x2 covariances (px²).
///
/// The pixels belong to the image that `camera` belongs to; lens distortion is undone on them, and those beyond the domain of
/// the lens model take no part ([`Residual::outside_lens`]), as long as 4 others are left. Up to two alternatives
/// come with the pose: modes at least 15 degrees apart, weighted by `exp(-cost / 2) sqrt(det covariance)` (Laplace's
/// approximation of their posterior). No heap is used. Same input, same bits.
///
/// ```
/// use nalgebra::{Matrix2, Vector2, Vector3};
/// use posed_core::geometry::Camera;
/// use posed_core::pnp::{Options, Status, solve};
///
/// let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5)?;
/// let points = [[0., 0., 0.], [0.1, 0., 0.], [0., 0.1, 0.], [0., 0., 0.1], [0.1, 0.1, 0.], [0.1, 0., 0.1]].map(Vector3::from);
/// // Seen from half a metre along z, and rounded to whole pixels.
/// let pixels = [[320., 240.], [440., 240.], [320., 360.], [320., 240.], [440., 360.], [420., 240.]].map(Vector2::from);
/// let solution = solve(&points, &pixels, &[Matrix2::identity() * 0.1; 6], &camera, &Options::default())?;
/// assert_eq!(solution.status, Status::Ok);
/// assert!((solution.pose.translation().z - 0.5).abs() < 3.0 * solution.covariance[(2, 2)].sqrt());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
    let modes = find_modes(&problem, options.previous);
    let mut solution = assemble(&problem, &modes, points, pixels, camera)?;
    judge(&mut solution, &modes, options);
    Ok(solution)
}

type Modes = Ranking<Mode, MAX_MODES>;

/// A pose at its least squares over its inliers.
#[derive(Clone, Copy, Debug)]
struct Mode {
    pose: Pose,
    /// Squared Mahalanobis distances, each cut off at the inlier threshold.
    cost: f64,
    covariance: Covariance6,
}

#[derive(Clone, Copy, Debug)]
struct Hypothesis {
    pose: Pose,
    cost: f64,
}

impl Candidate for Mode {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn cost(&self) -> f64 {
        self.cost
    }
}

impl Candidate for Hypothesis {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn cost(&self) -> f64 {
        self.cost
    }
}

fn find_modes(problem: &Problem, previous: Option<Pose>) -> Modes {
    let triplets = Triplets::new(problem, FIRST_TRIPLETS);
    let mut candidates = Ranking::<Hypothesis, MAX_CANDIDATES>::default();
    if let Some(pose) = previous {
        propose(problem, &mut candidates, pose);
    }
    let first = triplets.len().min(FIRST_TRIPLETS);
    triplets.solve(problem, 0..first, |pose| propose(problem, &mut candidates, pose));
    let settled = candidates.best().and_then(|best| finish(problem, best.pose)).filter(|mode| settles(problem, mode));
    if settled.is_none() {
        triplets.solve(problem, first..triplets.len(), |pose| propose(problem, &mut candidates, pose));
    }
    refine_all(problem, &candidates, settled.as_ref())
}

/// Whether a mode agrees with so many points that no other pose is left to be found: one that agrees with as many
/// shares five points with it, which fix a pose but for its mirror image, and that is tried anyway.
fn settles(problem: &Problem, mode: &Mode) -> bool {
    let seen = problem.observations();
    let agrees = |point: &&WhitenedPoint| point.mahalanobis_squared(&mode.pose) < INLIER.limit;
    2 * seen.iter().filter(agrees).count() >= seen.len() + 5
}

/// Ranks a pose by its MSAC cost, and gives up as soon as that is too high.
fn propose(problem: &Problem, candidates: &mut Ranking<Hypothesis, MAX_CANDIDATES>, pose: Pose) {
    let limit = candidates.worst();
    let mut cost = 0.0;
    for seen in problem.observations() {
        cost += seen.mahalanobis_squared(&pose).min(MISFIT);
        if cost >= limit {
            return;
        }
    }
    candidates.insert(Hypothesis { pose, cost });
}

/// Every mode that the candidates lead to; `known` is the one that the best of them led to, if that is known already.
fn refine_all(problem: &Problem, candidates: &Ranking<Hypothesis, MAX_CANDIDATES>, known: Option<&Mode>) -> Modes {
    let mut promising = Ranking::<Hypothesis, MAX_CANDIDATES>::default();
    let mut glance = |start: Pose| {
        if let Some(Refined { pose, cost, .. }) = refine(problem, start, &ROBUST, GLANCE) {
            promising.insert(Hypothesis { pose, cost });
        }
    };
    let worth_a_glance = candidates.best().map_or(f64::INFINITY, |best| best.cost + POOR);
    let others = candidates.iter().skip(usize::from(known.is_some()));
    for candidate in others.filter(|candidate| candidate.cost < worth_a_glance) {
        glance(candidate.pose);
    }
    if let Some(best) = candidates.best() {
        glance(mirrored(problem, &best.pose));
    }
    let mut modes = Modes::default();
    let robust_cost = |mode: &Mode| Refined::at(problem, mode.pose, &ROBUST).map_or(f64::INFINITY, |at| at.cost);
    let lowest = promising.best().map_or(f64::INFINITY, |best| best.cost).min(known.map_or(f64::INFINITY, robust_cost));
    if let Some(mode) = known {
        modes.insert(*mode);
    }
    for candidate in promising.iter().filter(|candidate| candidate.cost < lowest + HOPELESS) {
        if let Some(mode) = finish(problem, candidate.pose) {
            modes.insert(mode);
        }
    }
    modes
}

/// The robust optimum near a pose, and from there the least squares over the inliers, whose Hessian tells the truth.
fn finish(problem: &Problem, start: Pose) -> Option<Mode> {
    let robust = refine(problem, start, &ROBUST, ROUGH)?;
    let least_squares = refine(problem, robust.pose, &INLIER, EXACT)?;
    if let Some(covariance) = inverse(&least_squares) {
        return Some(Mode { pose: least_squares.pose, cost: least_squares.cost, covariance });
    }
    // Too few inliers to fix a pose: what there is rests on all points.
    let covariance = inverse(&robust)?;
    Some(Mode { pose: robust.pose, cost: Refined::at(problem, robust.pose, &INLIER)?.cost, covariance })
}

fn inverse(refined: &Refined) -> Option<Covariance6> {
    let inverse = refined.hessian.cholesky()?.inverse();
    inverse.iter().all(|v| v.is_finite()).then_some(inverse)
}

fn assemble(
    problem: &Problem,
    modes: &Modes,
    points: &[Vector3<f64>],
    pixels: &[Vector2<f64>],
    camera: &Camera,
) -> Result<Solution, PnpError> {
    // Also those points that took no part: nobody stands inside the object.
    let in_front = |mode: &&Mode| points.iter().all(|point| mode.pose.transform(point).z > 0.0);
    let best = modes.best().filter(in_front).ok_or(PnpError::NoPose)?;
    let mut residuals = [Residual::OUTSIDE; MAX_POINTS];
    let mut chi2 = 0.0;
    let mut inliers = 0_usize;
    for seen in problem.observations() {
        let projected = camera.project(&best.pose.transform(&seen.point));
        let error_px = projected.map_or(Vector2::repeat(f64::INFINITY), |projected| projected - pixels[seen.index]);
        let squared = seen.mahalanobis_squared(&best.pose);
        let inlier = squared < INLIER.limit;
        residuals[seen.index] = Residual { error_px, squared, inlier, outside_lens: false };
        if inlier {
            inliers += 1;
            chi2 += squared;
        }
    }
    let degrees_of_freedom = (2 * inliers).saturating_sub(6);
    let reduced = chi2 / degrees_of_freedom.max(1) as f64;
    let inflation = if chi2 > improbable(degrees_of_freedom as f64) { reduced } else { 1.0 };
    let weights = mode_weights(modes);
    let mut alternatives = [None; 2];
    for (slot, (mode, weight)) in alternatives.iter_mut().zip(modes.iter().zip(weights).skip(1)) {
        *slot = Some(Alternative { pose: mode.pose, covariance: mode.covariance * inflation, weight });
    }
    Ok(Solution {
        pose: best.pose,
        covariance: best.covariance * inflation,
        chi2,
        degrees_of_freedom,
        residuals,
        points: pixels.len(),
        weight: weights[0],
        alternatives,
        status: Status::Ok,
        doubts: Doubts::default(),
    })
}

/// 99 % point of chi-squared (Wilson and Hilferty's approximation, within 1 % for these degrees of freedom).
pub(crate) fn improbable(degrees_of_freedom: f64) -> f64 {
    const NORMAL_99: f64 = 2.326;
    let n = degrees_of_freedom.max(1.0);
    let spread = 2.0 / (9.0 * n);
    n * (1.0 - spread + NORMAL_99 * spread.sqrt()).powi(3)
}

fn mode_weights(modes: &Modes) -> [f64; MAX_MODES] {
    let lowest = modes.best().map_or(0.0, |mode| mode.cost);
    let mut weights = [0.0; MAX_MODES];
    for (weight, mode) in weights.iter_mut().zip(modes.iter()) {
        *weight = (-0.5 * (mode.cost - lowest)).exp() * mode.covariance.determinant().max(0.0).sqrt();
    }
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 { weights.map(|weight| weight / sum) } else { [1.0, 0.0, 0.0] }
}

fn judge(solution: &mut Solution, modes: &Modes, options: &Options) {
    let limit = modes.best().map_or(0.0, |best| best.cost + AMBIGUOUS_COST);
    let heavy = |other: &Alternative| other.weight > options.max_alternative_weight;
    let inliers = solution.inlier_count();
    let doubts = Doubts {
        planar_ambiguity: modes.iter().skip(1).any(|other| other.cost < limit)
            || solution.alternatives.iter().flatten().any(heavy),
        high_residual: solution.chi2 / solution.degrees_of_freedom.max(1) as f64 > options.max_reduced_chi2,
        few_inliers: inliers < options.min_inliers
            || (inliers as f64) < options.min_inlier_share * solution.residuals().len() as f64,
    };
    let worst = [
        (doubts.planar_ambiguity, Status::Ambiguous),
        (doubts.high_residual || doubts.few_inliers, Status::LowConfidence),
        (doubts.few_inliers && inliers < MIN_POINTS, Status::Rejected),
    ];
    solution.status =
        worst.into_iter().filter(|(holds, _)| *holds).map(|(_, status)| status).max().unwrap_or(Status::Ok);
    solution.doubts = doubts;
}
