//! Streams of measurements with known errors.

use posed_core::geometry::{Covariance6, Pose, Symmetries};
use posed_core::nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
use posed_core::tracking::{Measurement, Options, Shape, TrackView, Tracker};
use rand::rngs::SmallRng;
use rand_distr::{Distribution as _, StandardNormal};

pub(crate) const FRAME_S: f64 = 1.0 / 30.0;

/// Independent errors, so that nothing about the measurements is assumed that is not so.
pub(crate) fn independent() -> Options {
    Options { error_memory_s: 0.0, ..Options::default() }
}

pub(crate) fn shape() -> Shape {
    Shape { symmetries: Symmetries::default(), diameter_m: 0.1 }
}

/// A bar that a half turn about x leaves as it is.
pub(crate) fn half_turn() -> Pose {
    Pose::new(Rotation3::new(Vector3::x() * std::f64::consts::PI), Vector3::zeros())
}

pub(crate) fn tracker(options: Options) -> Tracker {
    Tracker::new(options, vec![shape()]).unwrap()
}

pub(crate) fn gaussian(random: &mut SmallRng) -> Vector6<f64> {
    Vector6::from_fn(|_, _| StandardNormal.sample(random))
}

/// 2 mm across, 5 mm along the optical axis, 1 degree; a little of each in the other.
pub(crate) fn covariance() -> Covariance6 {
    let sigmas = Vector6::new(0.002, 0.002, 0.005, 0.017, 0.017, 0.017);
    let mixed = Matrix6::from_fn(|row, column| if row == column { 1.0 } else { 0.2 / (1.0 + (row + column) as f64) });
    let root = Matrix6::from_diagonal(&sigmas) * mixed;
    root * root.transpose()
}

pub(crate) fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
    pose.perturbed(&step.fixed_rows::<3>(0).into_owned(), &step.fixed_rows::<3>(3).into_owned())
}

/// The truth with an error that has this covariance.
pub(crate) fn measured(truth: &Pose, covariance: &Covariance6, random: &mut SmallRng) -> Pose {
    moved(truth, &(covariance.cholesky().unwrap().l() * gaussian(random)))
}

pub(crate) fn at(x: f64) -> Pose {
    Pose::new(Rotation3::new(Vector3::new(0.3, -0.5, 0.2)), Vector3::new(x, 0.05, 0.6))
}

pub(crate) fn saw(pose: Pose) -> Measurement<'static> {
    Measurement { object: 0, world_from_object: pose, covariance: covariance(), alternatives: &[], expected: None }
}

/// Frame after frame.
pub(crate) struct Stream {
    pub tracker: Tracker,
    pub time_s: f64,
}

impl Stream {
    pub(crate) fn new(options: Options) -> Self {
        Self { tracker: tracker(options), time_s: 5.0 }
    }

    pub(crate) fn frame(&mut self, measurements: &[Measurement<'_>]) -> Vec<TrackView> {
        self.time_s += FRAME_S;
        self.tracker.update(self.time_s, measurements).unwrap()
    }

    /// So many frames that all see an object at one place; the last answer.
    pub(crate) fn seen_for(&mut self, frames: usize, pose: Pose) -> Vec<TrackView> {
        (0..frames).map(|_| self.frame(&[saw(pose)])).last().unwrap()
    }
}
