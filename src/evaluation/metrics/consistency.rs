use nalgebra::{DMatrix, DVector, Matrix6, Unit, Vector3, Vector6};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::model_points::ModelPoints;
use super::statistics::{mean, median, share};
use crate::evaluation::across::across;
use posed_core::geometry::{ContinuousSymmetry, Covariance6, Pose, covariance_about};

/// Ellipsoids of which the coverage is counted.
const LEVELS: [f64; 3] = [0.5, 0.9, 0.95];
/// Two numbers of a covariance that should be equal may differ so much, of the sigmas' product.
const SYMMETRIC: f64 = 1e-6;
/// A direction whose variance is a smaller share than this of what its axes have counts as without any.
const SINGULAR: f64 = 1e-12;

/// A normalised estimation error squared, `eᵀ Σ⁻¹ e`: Bar-Shalom et al., Estimation with Applications to Tracking and Navigation
/// (2001), section 5.4.2. Of an honest Gaussian covariance it has the chi-square distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Nees {
    /// No unit.
    pub value: f64,
    /// Degrees of freedom.
    pub degrees: u32,
}

impl Nees {
    /// The share of honest errors that are smaller, 0..1: the level of the ellipsoid on whose surface this error lies.
    #[must_use]
    pub fn level(&self) -> Option<f64> {
        Some(ChiSquared::new(self.degrees.into()).ok()?.cdf(self.value))
    }
}

/// The error of a pose in units of its own covariance.
///
/// The error is the step from the estimate to the nearest pose that looks like the true one ([`Pose::step_to`]), so it lives where
/// the covariance does: x, y, z (m) and a rotation (rad) about the axes of frame `camera`. A turn about an axis of revolution is
/// no error and has no degree of freedom: 5 are left, and 2 of the rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseNees {
    /// All of the pose: 6 degrees.
    pub pose: Nees,
    /// Of the object's centre along the ray on which the estimate has it: 1 degree.
    pub depth: Nees,
    /// Of the object's centre across that ray: 2 degrees.
    pub lateral: Nees,
    /// 3 degrees.
    pub rotation: Nees,
}

impl PoseNees {
    /// Of an estimate of `camera_from_object` with its covariance (as in `posed_core::geometry`). `None` if the covariance is not
    /// one: not finite, not symmetric or not positive definite; or if a pose is not finite.
    #[must_use]
    pub fn new(points: &ModelPoints, estimate: &Pose, covariance: &Covariance6, truth: &Pose) -> Option<Self> {
        let finite = [estimate, truth].iter().all(|pose| pose.matrix().iter().all(|value| value.is_finite()));
        let covariance = checked(covariance).filter(|_| finite)?;
        let truth = points.symmetries().nearest(truth, estimate);
        let axis = points.symmetries().continuous().first();
        // The nearest pose has no turn about the axis from the estimate, so the error needs no such step.
        let error = estimate.step_to(&truth);
        let about_origin = axis.map_or(covariance, |axis| without_turns(axis, estimate, &covariance));
        // Seen from the object's centre, along and across the ray to it.
        let centre = points.centre();
        let lever = estimate.rotation() * centre;
        let of_centre = truth.transform(&centre) - estimate.transform(&centre);
        let about_centre = covariance_about(&about_origin, &lever);
        let ray = Unit::try_new(estimate.transform(&centre), 1e-12).unwrap_or_else(Vector3::z_axis);
        let lateral = across(&ray);

        let rotation = match axis {
            Some(axis) => across(&(estimate.rotation() * axis.axis)).to_vec(),
            None => vec![Vector3::x(), Vector3::y(), Vector3::z()],
        };
        let turn: Vector3<f64> = error.fixed_rows::<3>(3).into();
        let moved = |axis: &Vector3<f64>| twist(axis, &Vector3::zeros());
        let turned = |axis: &Vector3<f64>| twist(&Vector3::zeros(), axis);
        let centre_error = twist(&of_centre, &turn);
        let turns: Vec<_> = rotation.iter().map(turned).collect();
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| moved(&axis));
        Some(Self {
            pose: nees(&[&axes[..], &turns].concat(), &error, &about_origin)?,
            depth: nees(&[moved(&ray)], &centre_error, &about_centre)?,
            lateral: nees(&lateral.map(|axis| moved(&axis)), &centre_error, &about_centre)?,
            rotation: nees(&turns, &error, &about_origin)?,
        })
    }
}

/// The covariance after the turn about an axis of revolution that undoes the error's own turn about it.
fn without_turns(axis: &ContinuousSymmetry, estimate: &Pose, covariance: &Covariance6) -> Covariance6 {
    // The step of a small turn about it, which moves the origin too where it lies beside the axis.
    let direction = estimate.rotation() * *axis.axis;
    let turn = twist(&(estimate.rotation() * axis.offset_m.cross(&axis.axis)), &direction);
    let undo = Matrix6::identity() - turn * twist(&Vector3::zeros(), &direction).transpose();
    undo * covariance * undo.transpose()
}

fn twist(translation: &Vector3<f64>, rotation: &Vector3<f64>) -> Vector6<f64> {
    let mut twist = Vector6::zeros();
    twist.fixed_rows_mut::<3>(0).copy_from(translation);
    twist.fixed_rows_mut::<3>(3).copy_from(rotation);
    twist
}

/// The covariance, exactly symmetric, if it is one.
fn checked(covariance: &Covariance6) -> Option<Covariance6> {
    let variances = covariance.diagonal();
    let scale = |row: usize, column: usize| (variances[row] * variances[column]).sqrt();
    let symmetric = |(row, column): (usize, usize)| {
        let apart = covariance[(row, column)] - covariance[(column, row)];
        apart.abs() <= SYMMETRIC * scale(row, column)
    };
    let finite = covariance.iter().all(|value| value.is_finite()) && variances.iter().all(|variance| *variance > 0.0);
    let pairs = || (0..6).flat_map(|row| (0..row).map(move |column| (row, column)));
    (finite && pairs().all(symmetric)).then(|| (covariance + covariance.transpose()) / 2.0)
}

/// Of the error along some directions, with its marginal covariance; `None` unless that is positive definite.
fn nees(directions: &[Vector6<f64>], error: &Vector6<f64>, covariance: &Covariance6) -> Option<Nees> {
    let size = directions.len();
    let along = DMatrix::from_fn(size, size, |row, column| directions[row].dot(&(covariance * directions[column])));
    let sigmas = DVector::from_fn(size, |row, _| along[(row, row)].sqrt());
    // In units of the sigmas, so that metres and radians are alike.
    let correlation = DMatrix::from_fn(size, size, |row, column| along[(row, column)] / (sigmas[row] * sigmas[column]));
    let factor = correlation.cholesky()?;
    if !factor.l_dirty().diagonal().iter().all(|pivot| pivot * pivot > SINGULAR) {
        return None;
    }
    let error = DVector::from_fn(size, |row, _| directions[row].dot(error) / sigmas[row]);
    let value = error.dot(&factor.solve(&error));
    let degrees = u32::try_from(size).ok()?;
    value.is_finite().then_some(Nees { value: value.max(0.0), degrees })
}

/// Whether the covariances of many poses say how large their errors are.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Poses without a usable covariance; the rest leaves them out.
    pub unusable: usize,
    /// All of the pose. `None`, as the others, if no pose is usable.
    pub pose: Option<GroupConsistency>,
    /// The centre's place along the ray.
    pub depth: Option<GroupConsistency>,
    /// The centre's place across the ray.
    pub lateral: Option<GroupConsistency>,
    /// The rotation.
    pub rotation: Option<GroupConsistency>,
}

/// NEES of one part of the poses' errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupConsistency {
    /// Poses.
    pub count: usize,
    /// Mean degrees of freedom, and the mean NEES of honest covariances.
    pub mean_degrees: f64,
    /// Mean NEES; one bad outlier rules it.
    pub mean: f64,
    /// Median NEES.
    pub median: f64,
    /// Errors in units of the stated sigma, `sqrt(mean(NEES / degrees))`: 1 is honest, more is too confident.
    pub sigma_ratio: f64,
    /// How many errors lie in the ellipsoids that should hold 50, 90 and 95 % of them.
    pub coverage: Vec<Coverage>,
}

/// Share of errors in the ellipsoid that should hold a given share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// The share that an honest covariance has, 0..1.
    pub level: f64,
    /// The share that was found, 0..1.
    pub share: f64,
}

impl Consistency {
    /// `None` stands for a pose without a usable covariance. Views without a pose do not belong here.
    #[must_use]
    pub fn of(poses: &[Option<PoseNees>]) -> Self {
        let usable = |part: fn(&PoseNees) -> Nees| GroupConsistency::of(poses.iter().flatten().map(part).collect());
        Self {
            unusable: poses.iter().filter(|pose| pose.is_none()).count(),
            pose: usable(|pose| pose.pose),
            depth: usable(|pose| pose.depth),
            lateral: usable(|pose| pose.lateral),
            rotation: usable(|pose| pose.rotation),
        }
    }
}

impl GroupConsistency {
    /// Share within the widest of the ellipsoids, which should hold 95 %.
    #[must_use]
    pub fn within_95(&self) -> Option<f64> {
        self.coverage.last().map(|coverage| coverage.share)
    }

    #[allow(clippy::needless_pass_by_value, reason = "collected for this")]
    fn of(all: Vec<Nees>) -> Option<Self> {
        let levels: Vec<_> = all.iter().map(Nees::level).collect::<Option<_>>()?;
        let covered = |level: f64| {
            let share = share(levels.iter().filter(|found| **found <= level).count(), all.len())?;
            Some(Coverage { level, share })
        };
        Some(Self {
            count: all.len(),
            mean_degrees: mean(all.iter().map(|nees| nees.degrees.into()))?,
            mean: mean(all.iter().map(|nees| nees.value))?,
            median: median(all.iter().map(|nees| nees.value))?,
            sigma_ratio: mean(all.iter().map(|nees| nees.value / f64::from(nees.degrees)))?.sqrt(),
            coverage: LEVELS.into_iter().map(covered).collect::<Option<_>>()?,
        })
    }
}
