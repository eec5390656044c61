//! Objects through the images of a stream: what is expected of the next image, and what an answer says to the tracks.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::answer::{Estimate, ObjectPose, Selection, SolvedPose};
use super::expected::{Expected, Guide};
use crate::model::{Library, ObjectModel};
use posed_core::geometry::{Covariance6, Pose, Symmetries, rotated_covariance};
use posed_core::tracking::{Measurement, Options, OptionsError, Shape, TimeError, TrackView, Tracker};

/// How a stream is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowOptions {
    /// The detector looks at every so many-th image, and whenever something is lost.
    pub detect_every: u32,
    pub motion: Options,
}

impl Default for FollowOptions {
    fn default() -> Self {
        Self { detect_every: 10, motion: Options::default() }
    }
}

/// An object of a stream at the time of its newest image.
#[derive(Clone, Debug)]
pub struct Tracked {
    pub object: String,
    /// In the caller's world; its covariance has the offset's, too.
    pub view: TrackView,
    pub camera_from_object: Pose,
    /// Along the axes of the camera.
    pub covariance: Covariance6,
    /// Place of the answer's pose that was taken.
    pub pose: Option<usize>,
}

/// The tracks of one stream. Whoever works on its images knows nothing of it: each brings its [`Guide`] along.
pub struct Follower {
    library: Arc<Library>,
    tracker: Tracker,
    detect_every: u32,
    /// Images since the detector looked.
    undetected: u32,
    known: BTreeMap<u64, Known>,
}

/// What is kept of a track beside its pose.
#[derive(Clone, Copy)]
struct Known {
    /// As the network saw it last: of a symmetric object, which of its equal poses.
    object_from_keypoints: Pose,
    keypoints_scale: f64,
    score: f64,
    /// The part of a pose's covariance that is the same in every image, along the axes of the object.
    of_offset: Covariance6,
}

impl Follower {
    /// # Errors
    /// When an option is out of its range.
    pub fn new(library: Arc<Library>, options: FollowOptions) -> Result<Self, OptionsError> {
        let tracker = Tracker::new(options.motion, shapes(&library))?;
        Ok(Self { library, tracker, detect_every: options.detect_every, undetected: 0, known: BTreeMap::new() })
    }

    /// Goes on with another library. What is another object now is not followed any further.
    fn adopt(&mut self, library: &Arc<Library>) {
        let old = std::mem::replace(&mut self.library, Arc::clone(library));
        let changed = |object: usize| {
            let models = [&old, library].map(|library| library.objects.get(object).and_then(Option::as_ref));
            !matches!(models, [Some(old), Some(new)] if Arc::ptr_eq(old, new))
        };
        self.tracker.reshape(shapes(library), changed);
    }

    /// Whether an image of this time (seconds, of any clock) can come next.
    ///
    /// # Errors
    /// [`TimeError`] where it cannot.
    pub fn check_time(&self, time_s: f64) -> Result<(), TimeError> {
        self.tracker.check_time(time_s)
    }

    /// What is expected of an image.
    #[must_use]
    pub fn guide(&self, time_s: f64, world_from_camera: &Pose, selection: &Selection) -> Guide {
        let camera_from_world = world_from_camera.inverse();
        let predictions = self.tracker.predictions(time_s);
        let expected = predictions.iter().filter_map(|prediction| {
            let least = self.library.least_score(prediction.object);
            let known = self.known.get(&prediction.id).filter(|known| known.score >= least)?;
            self.model(prediction.object).filter(|model| selection.wants(&model.manifest.name))?;
            let camera_from_object = camera_from_world * prediction.world_from_object;
            Some(Expected {
                track: prediction.id,
                object: prediction.object,
                camera_from_keypoints: camera_from_object * known.object_from_keypoints,
                keypoints_scale: known.keypoints_scale,
                score: known.score,
            })
        });
        let expected: Vec<Expected> = expected.collect();
        // Boxes of the caller are what a detector would see.
        let is_time = self.undetected + 1 >= self.detect_every || selection.boxes.is_some();
        let detect = is_time || expected.is_empty() || self.tracker.needs_detection();
        Guide { detect, expected, generation: self.library.generation() }
    }

    /// Takes the answer to an image that had this guide, and tells how all tracks are then.
    ///
    /// # Errors
    /// As [`Follower::check_time`]; nothing has changed then.
    pub fn take(
        &mut self,
        time_s: f64,
        world_from_camera: &Pose,
        guide: &Guide,
        estimate: &Estimate,
    ) -> Result<Vec<Tracked>, TimeError> {
        self.check_time(time_s)?;
        let library = &estimate.catalogue.library;
        if !Arc::ptr_eq(library, &self.library) {
            self.adopt(library);
        }
        let usable = |(_, pose): &(usize, &ObjectPose)| pose.verdict.is_measured();
        let poses = estimate.poses.iter().enumerate().filter(usable);
        let said: Vec<(usize, &ObjectPose, &SolvedPose)> =
            poses.filter_map(|(at, pose)| Some((at, pose, pose.pose.as_ref()?))).collect();
        let in_world = |(pose, _): &(Pose, f64)| *world_from_camera * *pose;
        let alternatives: Vec<Vec<Pose>> =
            said.iter().map(|(_, _, solved)| solved.alternatives.iter().map(in_world).collect()).collect();
        let measurement = |((_, pose, solved), alternatives): (&(usize, &ObjectPose, &SolvedPose), _)| {
            let (world_from_object, covariance) = solved.of_image_in_frame(world_from_camera);
            let (object, expected) = (pose.detection.object, pose.track);
            Measurement { object, world_from_object, covariance, alternatives, expected }
        };
        let measurements: Vec<Measurement<'_>> =
            said.iter().zip(alternatives.iter().map(Vec::as_slice)).map(measurement).collect();
        let mut views = self.tracker.update(time_s, &measurements)?;
        self.undetected = if guide.detect { 0 } else { self.undetected + 1 };
        self.note_scores(guide, estimate);
        let camera_from_world = world_from_camera.inverse();
        let mut tracked = Vec::with_capacity(views.len());
        for mut view in views.drain(..) {
            let taken = view.measurement.map(|measurement| said[measurement]);
            if let Some((_, pose, solved)) = taken {
                let known = self.seen(&view, world_from_camera, pose, solved);
                self.known.insert(view.id, known);
            }
            let Some((known, model)) = self.known.get(&view.id).zip(self.model(view.object)) else { continue };
            view.covariance += rotated_covariance(view.world_from_object.rotation(), &known.of_offset);
            tracked.push(Tracked {
                object: model.manifest.name.clone(),
                camera_from_object: camera_from_world * view.world_from_object,
                covariance: rotated_covariance(camera_from_world.rotation(), &view.covariance),
                pose: taken.map(|(at, _, _)| at),
                view,
            });
        }
        self.known.retain(|id, _| tracked.iter().any(|one| one.view.id == *id));
        Ok(tracked)
    }

    fn model(&self, object: usize) -> Option<&ObjectModel> {
        self.library.objects.get(object)?.as_deref()
    }

    /// What the detector says of what was expected.
    fn note_scores(&mut self, guide: &Guide, estimate: &Estimate) {
        for one in guide.expected.iter().filter(|_| guide.detect) {
            let answer = estimate.poses.iter().find(|pose| pose.track == Some(one.track));
            if let Some(known) = self.known.get_mut(&one.track) {
                known.score = answer.map_or(0.0, |pose| pose.detection.score);
            }
        }
    }

    fn seen(&self, view: &TrackView, world_from_camera: &Pose, pose: &ObjectPose, solved: &SolvedPose) -> Known {
        let measured = *world_from_camera * solved.camera_from_object;
        let like_track = |model: &ObjectModel| model.symmetries.nearest(&measured, &view.world_from_object);
        let world_from_object = self.model(view.object).map_or(measured, like_track);
        let object_from_world = world_from_object.inverse();
        let to_object = (object_from_world * *world_from_camera).rotation().to_owned();
        Known {
            object_from_keypoints: object_from_world * *world_from_camera * solved.camera_from_keypoints,
            keypoints_scale: solved.keypoints_scale,
            score: pose.detection.score,
            of_offset: rotated_covariance(&to_object, &(solved.covariance - solved.image_covariance)),
        }
    }
}

/// Numbered as the library's objects; where one was removed, nothing is ever measured.
fn shapes(library: &Library) -> Vec<Shape> {
    let nothing = Shape { symmetries: Symmetries::default(), diameter_m: 0.0 };
    let shape = |model: &Arc<ObjectModel>| Shape {
        symmetries: model.symmetries.clone(),
        diameter_m: model.manifest.diameter_m,
    };
    library.objects.iter().map(|model| model.as_ref().map_or_else(|| nothing.clone(), shape)).collect()
}
