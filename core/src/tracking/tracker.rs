//! All tracks of one stream of images.

use thiserror::Error;

use super::options::{Options, OptionsError};
use super::state::diagonal;
use super::track::{Shape, Track, TrackView};
use crate::geometry::{Covariance6, Pose};

/// Tracks at most, and as many lost ones.
pub const MAX_TRACKS: usize = 32;

/// Squared Mahalanobis distance beyond which a measurement is a jump: the 99.99 % point of chi-square with 6 degrees.
const GATE: f64 = 27.86;
/// Poses of one object that are nearer are of one thing: no two rigid bodies are so near. In diameters.
const SAME_THING: f64 = 0.25;
/// A lost track is found again within so many diameters ...
const UNMOVED: f64 = 0.5;
/// ... and so large a turn; jumps within it agree with each other.
const UNTURNED_RAD: f64 = 0.5;
/// After so many jumps in a row that agree, the track was wrong and not they.
const CONVINCING_JUMPS: u32 = 5;
/// Nothing is predicted further.
const MAX_STEP_S: f64 = 1.0;

/// What one image says of one object.
#[derive(Clone, Debug)]
pub struct Measurement<'a> {
    /// Place of the object among the tracker's shapes.
    pub object: usize,
    /// Where it is.
    pub world_from_object: Pose,
    /// Of [`Pose::perturbed`] along the axes of the world, this image's own part alone.
    pub covariance: Covariance6,
    /// Other poses that explain the image.
    pub alternatives: &'a [Pose],
    /// The track whose prediction it was looked for at; `None` where it was found without one.
    pub expected: Option<u64>,
}

/// Where a track is expected to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The track.
    pub id: u64,
    /// Place of its object among the tracker's shapes.
    pub object: usize,
    /// Its pose.
    pub world_from_object: Pose,
}

/// A frame that has no place in the stream.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TimeError {
    #[error("is {0}; it must be a finite number of seconds")]
    NotFinite(f64),
    #[error(
        "is {time_s}, which is not after that of the frame before it, {before_s}; send frames in the order of their capture"
    )]
    NotAfter { time_s: f64, before_s: f64 },
}

/// Follows objects through the frames of one stream.
pub struct Tracker {
    options: Options,
    shapes: Vec<Shape>,
    tracks: Vec<Track>,
    time_s: Option<f64>,
    next_id: u64,
}

/// A pair of a track and a measurement that may be one, and the pose that it then is.
struct Pair {
    track: usize,
    measurement: usize,
    distance: f64,
    pose: Pose,
    covariance: Covariance6,
}

impl Tracker {
    /// For objects of these shapes.
    ///
    /// # Errors
    /// When an option is out of its range.
    pub fn new(options: Options, shapes: Vec<Shape>) -> Result<Self, OptionsError> {
        options.check()?;
        Ok(Self { options, shapes, tracks: Vec::new(), time_s: None, next_id: 1 })
    }

    /// From now on objects have these shapes; those of which `changed` says so are others than before, and their tracks end.
    pub fn reshape(&mut self, shapes: Vec<Shape>, changed: impl Fn(usize) -> bool) {
        self.tracks.retain(|track| track.object < shapes.len() && !changed(track.object));
        self.shapes = shapes;
    }

    /// Whether a frame of this time (seconds, of any clock) can come next.
    ///
    /// # Errors
    /// [`TimeError`] where it is not finite, or not after the newest frame.
    pub fn check_time(&self, time_s: f64) -> Result<(), TimeError> {
        match self.time_s {
            _ if !time_s.is_finite() => Err(TimeError::NotFinite(time_s)),
            Some(before_s) if time_s <= before_s => Err(TimeError::NotAfter { time_s, before_s }),
            Some(_) | None => Ok(()),
        }
    }

    /// Where the tracks that are not lost will be at a time.
    #[must_use]
    pub fn predictions(&self, time_s: f64) -> Vec<Prediction> {
        let seconds = self.step(time_s);
        let live = self.tracks.iter().filter(|track| !track.lost);
        live.map(|track| Prediction {
            id: track.id,
            object: track.object,
            world_from_object: track.filter.after(seconds).mean().pose,
        })
        .collect()
    }

    /// Whether something is amiss that a look at the whole image may mend: nothing is tracked, or the newest frame is the first
    /// without a measurement of a track, or the one that lost it.
    #[must_use]
    pub fn needs_detection(&self) -> bool {
        self.tracks.iter().all(|track| track.lost) || self.tracks.iter().any(|track| track.has_just_gone)
    }

    /// Takes what a frame says, and tells how all tracks are then.
    ///
    /// # Errors
    /// As [`Tracker::check_time`]; nothing has changed then.
    pub fn update(&mut self, time_s: f64, measurements: &[Measurement<'_>]) -> Result<Vec<TrackView>, TimeError> {
        self.check_time(time_s)?;
        let seconds = self.step(time_s);
        self.time_s = Some(time_s);
        self.tracks.iter_mut().for_each(|track| track.advance(seconds));
        let mut free: Vec<usize> = (0..measurements.len()).collect();
        self.follow(time_s, measurements, &mut free);
        self.notice_jumps(time_s, measurements, &mut free);
        self.find_again(time_s, measurements, &mut free);
        self.begin(time_s, measurements, &free);
        let options = &self.options;
        self.tracks.retain_mut(|track| track.is_measured() || track.missed(time_s, options));
        self.forget_beyond_limit();
        Ok(self.views())
    }

    /// All tracks at the time of the newest frame.
    #[must_use]
    pub fn views(&self) -> Vec<TrackView> {
        let time_s = self.time_s.unwrap_or_default();
        self.tracks.iter().map(|track| track.view(time_s)).collect()
    }

    fn step(&self, time_s: f64) -> f64 {
        self.time_s.map_or(0.0, |before_s| (time_s - before_s).clamp(0.0, MAX_STEP_S))
    }

    /// The pairs within the gate, the nearest first.
    fn follow(&mut self, time_s: f64, measurements: &[Measurement<'_>], free: &mut Vec<usize>) {
        let mut pairs: Vec<Pair> = Vec::new();
        for (at, track) in self.tracks.iter().enumerate().filter(|(_, track)| !track.lost) {
            let of_object = measurements.iter().enumerate().filter(|(_, one)| one.object == track.object);
            pairs.extend(of_object.filter_map(|(measurement, one)| self.pair(time_s, at, measurement, one)));
        }
        pairs.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        let mut taken: Vec<(usize, Pose)> = Vec::new();
        for Pair { track, measurement, pose, covariance, .. } in pairs {
            let object = self.tracks[track].object;
            let there = |(other, at): &(usize, Pose)| *other == object && self.is_same_thing(object, at, &pose);
            // A measurement is one track's, and what two tracks measure at one place is one thing.
            if self.tracks[track].is_measured() || taken.iter().any(there) {
                continue;
            }
            taken.push((object, pose));
            free.retain(|one| *one != measurement);
            let track = &mut self.tracks[track];
            if let Some(fit) = track.filter.fit(&pose, &covariance) {
                track.filter.take(&fit, &covariance);
                track.measured(time_s, measurement);
            }
        }
        // What is left over at a place that is taken says nothing new.
        free.retain(|one| {
            let one = &measurements[*one];
            !taken
                .iter()
                .any(|(object, at)| *object == one.object && self.is_same_thing(one.object, at, &one.world_from_object))
        });
    }

    /// A pair if it is within the gate: by the measured pose, or else by one of its alternatives.
    fn pair(&self, time_s: f64, track: usize, measurement: usize, said: &Measurement<'_>) -> Option<Pair> {
        let of_track = &self.tracks[track];
        let predicted = of_track.filter.mean().pose;
        let symmetries = &self.shapes[said.object].symmetries;
        let alike = self.alike_factor(time_s - of_track.measured_s);
        let pair = |said_pose: &Pose| {
            let (pose, covariance) = symmetries.nearest_with(said_pose, &said.covariance, &predicted);
            let covariance = covariance * alike;
            let distance = of_track.filter.fit(&pose, &covariance)?.distance();
            (distance <= GATE).then_some(Pair { track, measurement, distance, pose, covariance })
        };
        pair(&said.world_from_object).or_else(|| said.alternatives.iter().find_map(pair))
    }

    /// By how much a measurement says less than it would if its error had nothing to do with that of the one before.
    fn alike_factor(&self, since_s: f64) -> f64 {
        // The same as if only every so many-th frame were there, with independent errors.
        (self.options.error_memory_s / since_s.max(1e-3)).max(1.0)
    }

    fn is_same_thing(&self, object: usize, a: &Pose, b: &Pose) -> bool {
        self.is_near(object, a, b, SAME_THING)
    }

    fn is_near(&self, object: usize, a: &Pose, b: &Pose, diameters: f64) -> bool {
        (a.translation() - b.translation()).norm() <= diameters * self.shapes[object].diameter_m
    }

    fn is_unmoved(&self, object: usize, before: &Pose, now: &Pose) -> bool {
        let now = self.shapes[object].symmetries.nearest(now, before);
        self.is_near(object, before, &now, UNMOVED) && before.angle_to(&now) <= UNTURNED_RAD
    }

    /// Measurements that are beyond the gate of the track that they were looked for at, or that is where they are.
    fn notice_jumps(&mut self, time_s: f64, measurements: &[Measurement<'_>], free: &mut Vec<usize>) {
        free.retain(|measurement| {
            let said = &measurements[*measurement];
            let pose = said.world_from_object;
            let at = self.tracks.iter().position(|track| {
                let place = || self.is_near(track.object, &track.filter.mean().pose, &pose, UNMOVED);
                !track.lost
                    && !track.is_measured()
                    && track.object == said.object
                    && said.expected.map_or_else(place, |id| id == track.id)
            });
            let Some(at) = at else { return true };
            // Another track that is there is what was measured.
            let is_taken = self.tracks.iter().enumerate().any(|(other, track)| {
                other != at
                    && track.object == said.object
                    && track.is_measured()
                    && self.is_near(track.object, &track.last.0, &pose, UNMOVED)
            });
            let agrees = self.tracks[at].jumped_to().is_some_and(|before| self.is_unmoved(said.object, before, &pose));
            let count = self.tracks[at].jump(&pose, agrees);
            if count >= CONVINCING_JUMPS && !is_taken {
                let found = self.first(said);
                self.tracks[at].restart(time_s, &found, *measurement, &self.options);
            }
            false
        });
    }

    /// Lost tracks are where they were.
    fn find_again(&mut self, time_s: f64, measurements: &[Measurement<'_>], free: &mut Vec<usize>) {
        free.retain(|measurement| {
            let said = &measurements[*measurement];
            let place = said.world_from_object;
            let lost = self.tracks.iter().enumerate().filter(|(_, track)| {
                track.lost && track.object == said.object && self.is_unmoved(said.object, &track.last.0, &place)
            });
            let distance = |track: &Track| (track.last.0.translation() - place.translation()).norm();
            let nearest = lost.min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b))).map(|(at, _)| at);
            let Some(at) = nearest else { return true };
            let last = self.tracks[at].last.0;
            let (pose, covariance) = self.first(said);
            let found = self.shapes[said.object].symmetries.nearest_with(&pose, &covariance, &last);
            self.tracks[at].restart(time_s, &found, *measurement, &self.options);
            false
        });
    }

    /// What nobody has seen before.
    fn begin(&mut self, time_s: f64, measurements: &[Measurement<'_>], free: &[usize]) {
        for measurement in free {
            let said = &measurements[*measurement];
            let live = || self.tracks.iter().filter(|track| !track.lost);
            let is_there = live().any(|track| {
                track.object == said.object
                    && self.is_same_thing(said.object, &track.filter.mean().pose, &said.world_from_object)
            });
            if said.expected.is_none() && !is_there && live().count() < MAX_TRACKS {
                let found = self.first(said);
                let track = Track::new(self.next_id, said.object, time_s, &found, *measurement, &self.options);
                self.tracks.push(track);
                self.next_id += 1;
            }
        }
    }

    /// What a track begins with. A covariance that is none is replaced by one that says little.
    fn first(&self, said: &Measurement<'_>) -> (Pose, Covariance6) {
        let usable = said.covariance.cholesky().is_some();
        let loose = || diagonal([self.shapes[said.object].diameter_m.powi(2), 1.0]);
        (said.world_from_object, if usable { said.covariance } else { loose() })
    }

    /// Of too many lost tracks the oldest go.
    fn forget_beyond_limit(&mut self) {
        let mut lost: Vec<f64> = self.tracks.iter().filter(|t| t.lost).map(|t| t.measured_s).collect();
        lost.sort_by(|a, b| b.total_cmp(a));
        if let Some(oldest) = lost.get(MAX_TRACKS) {
            self.tracks.retain(|track| !track.lost || track.measured_s > *oldest);
        }
    }
}
