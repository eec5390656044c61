//! One object over time.

use nalgebra::Vector6;

use super::filter::Filter;
use super::options::Options;
use crate::geometry::{Covariance6, Pose, Symmetries};

/// Measurements after which a track is no longer new.
const CONFIRMED: u32 = 3;

/// What tracking needs to know of an object.
#[derive(Clone, Debug)]
pub struct Shape {
    /// The motions under which it looks the same.
    pub symmetries: Symmetries,
    /// Its largest extent, metres.
    pub diameter_m: f64,
}

/// How far a track can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackState {
    /// Seen, but not often yet. If it is not seen again it goes without a word.
    New,
    /// Measured in this frame.
    Tracked,
    /// Not measured in this frame: its pose is where it would be if it went on as before.
    Coasting,
    /// Not measured for long: its pose is the last one that was measured.
    Lost,
}

/// A track as it is at the time of the newest frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackView {
    /// Of this track alone.
    pub id: u64,
    /// Place of the object among the tracker's shapes.
    pub object: usize,
    /// How far it can be trusted.
    pub state: TrackState,
    /// Since its first measurement.
    pub age_s: f64,
    /// Since its newest one: 0 where this frame has one.
    pub unseen_s: f64,
    /// The filtered pose.
    pub world_from_object: Pose,
    /// Of [`Pose::perturbed`] along the axes of the world.
    pub covariance: Covariance6,
    /// m/s and rad/s along the axes of the world.
    pub velocity: Vector6<f64>,
    /// Place of the measurement that was taken.
    pub measurement: Option<usize>,
    /// Whether there was a measurement too far off to be taken.
    pub jumped: bool,
}

pub(super) struct Track {
    pub id: u64,
    pub object: usize,
    pub filter: Filter,
    pub lost: bool,
    /// Measurements taken.
    hits: u32,
    /// Frames since the newest of them.
    missed: u32,
    born_s: f64,
    pub measured_s: f64,
    /// The filtered pose when it was last measured.
    pub last: (Pose, Covariance6),
    /// Measurements in a row that were too far off, and agree with each other: where, and how many.
    jumps: Option<(Pose, u32)>,
    measurement: Option<usize>,
    jumped: bool,
    /// Whether this frame is the first without a measurement, or the one that lost it.
    pub has_just_gone: bool,
}

impl Track {
    pub(super) fn new(
        id: u64,
        object: usize,
        time_s: f64,
        measured: &(Pose, Covariance6),
        measurement: usize,
        options: &Options,
    ) -> Self {
        Self {
            id,
            object,
            filter: Filter::new(measured.0, &measured.1, options),
            lost: false,
            hits: 1,
            missed: 0,
            born_s: time_s,
            measured_s: time_s,
            last: *measured,
            jumps: None,
            measurement: Some(measurement),
            jumped: false,
            has_just_gone: false,
        }
    }

    /// To the time of a new frame, before its measurements.
    pub(super) fn advance(&mut self, seconds: f64) {
        (self.measurement, self.jumped, self.has_just_gone) = (None, false, false);
        if !self.lost {
            self.filter = self.filter.after(seconds);
        }
    }

    /// What is counted of a measurement that the filter has taken.
    pub(super) fn measured(&mut self, time_s: f64, measurement: usize) {
        (self.hits, self.missed) = (self.hits.saturating_add(1), 0);
        (self.measured_s, self.measurement, self.jumps, self.lost) = (time_s, Some(measurement), None, false);
        let mean = self.filter.mean();
        self.last = (mean.pose, mean.pose_covariance());
    }

    /// Begins anew at a pose, as the same track.
    pub(super) fn restart(&mut self, time_s: f64, at: &(Pose, Covariance6), measurement: usize, options: &Options) {
        self.filter = Filter::new(at.0, &at.1, options);
        self.measured(time_s, measurement);
    }

    /// Where the newest of the measurements in a row was that were too far off.
    pub(super) fn jumped_to(&self) -> Option<&Pose> {
        self.jumps.as_ref().map(|(pose, _)| pose)
    }

    /// A measurement that is too far off, and may agree with the one before: how many do in a row, this one included.
    pub(super) fn jump(&mut self, pose: &Pose, agrees: bool) -> u32 {
        self.jumped = true;
        let before = self.jumps.filter(|_| agrees).map_or(0, |(_, count)| count);
        self.jumps = Some((*pose, before + 1));
        before + 1
    }

    /// A frame ends without a measurement. False where the track ends with it.
    pub(super) fn missed(&mut self, time_s: f64, options: &Options) -> bool {
        self.missed = self.missed.saturating_add(1);
        if !self.jumped {
            self.jumps = None;
        }
        let unseen_s = time_s - self.measured_s;
        if self.lost {
            return unseen_s <= options.forget_s;
        }
        self.lost = unseen_s > options.max_coast_s && self.missed >= Options::MIN_COAST_FRAMES;
        self.has_just_gone = self.lost || self.missed == 1;
        !self.lost || self.hits >= CONFIRMED
    }

    pub(super) fn is_measured(&self) -> bool {
        self.measurement.is_some()
    }

    pub(super) fn view(&self, time_s: f64) -> TrackView {
        let mean = self.filter.mean();
        let (world_from_object, covariance) = if self.lost { self.last } else { (mean.pose, mean.pose_covariance()) };
        let state = match (self.lost, self.is_measured()) {
            (true, _) => TrackState::Lost,
            (false, false) => TrackState::Coasting,
            (false, true) if self.hits < CONFIRMED => TrackState::New,
            (false, true) => TrackState::Tracked,
        };
        TrackView {
            id: self.id,
            object: self.object,
            state,
            age_s: time_s - self.born_s,
            unseen_s: time_s - self.measured_s,
            world_from_object,
            covariance,
            velocity: if self.lost { Vector6::zeros() } else { mean.velocity },
            measurement: self.measurement,
            jumped: self.jumped,
        }
    }
}
