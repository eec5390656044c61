//! One scene's images, in their order.

use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Arc;
use std::time::{Duration, Instant as Clock};

use serde::Serialize;

use super::super::options::Asked;
use super::super::plan::visible_fraction;
use super::super::work::Known;
use crate::estimator::{Estimator, FollowOptions, Follower, Frame, Selection, Tracked};
use crate::evaluation::{Followed, Instant, ReadOptions, Scene, SceneFolder, StreamScore, View, assign};
use crate::model::Library;
use crate::vision::{DecodeOptions, read_image};
use posed_core::geometry::Pose;
use posed_core::tracking::TrackState;

/// A pose is at an instance if their origins are nearer, in diameters.
const AT: f64 = 0.5;

/// What all scenes have in common.
pub(super) struct Replay<'a> {
    pub(super) asked: &'a Asked,
    pub(super) known: &'a [Known],
    pub(super) library: &'a Arc<Library>,
    pub(super) options: &'a ReadOptions,
}

/// What became of one scene.
#[derive(Debug, Serialize)]
pub(super) struct Replayed {
    pub(super) scene: String,
    pub(super) images: usize,
    /// Time of detector, networks and solver, without reading the images, seconds.
    pub(super) single_s: f64,
    pub(super) stream_s: f64,
    /// Images of the stream that the detector looked at.
    pub(super) detected: usize,
    /// Live tracks at no instance, each counted in each image.
    pub(super) astray: usize,
    pub(super) objects: Vec<(String, StreamScore)>,
}

/// An instance to be followed: object, and its place in the scene's lists.
type Key = (usize, usize);

impl Replay<'_> {
    pub(super) fn scene(&self, estimator: &mut Estimator, folder: &SceneFolder) -> Result<Replayed, Box<dyn Error>> {
        let scene = folder.read(self.options)?;
        let views = scene.image_ids().map(|image_id| scene.view(image_id)).collect::<Result<Vec<View>, _>>()?;
        // Where not all cameras' poses are known, the world is the camera's frame.
        let in_world = views.iter().all(|view| view.world_from_camera.is_ok());
        let splits = &self.asked.splits;
        let options = FollowOptions { detect_every: splits.detect_every, ..FollowOptions::default() };
        let mut follower = Follower::new(Arc::clone(self.library), options)?;
        let selection = Selection { objects: Some(self.asked.objects.clone()), ..Selection::ALL };
        let mut done = Replayed::nothing_of(&scene, views.len());
        let (mut single_time, mut stream_time) = (Duration::ZERO, Duration::ZERO);
        let mut instances: BTreeMap<Key, Vec<Instant>> = BTreeMap::new();
        for view in views {
            let image = read_image(&view.image, &DecodeOptions::default())?;
            let world = view.world_from_camera.as_ref().ok().filter(|_| in_world);
            let world_from_camera = world.copied().unwrap_or_else(Pose::identity);
            let frame = Frame { selection: &selection, ..Frame::new(&image, &view.camera) };
            let start = Clock::now();
            let alone = estimator.estimate_frame(&frame)?;
            single_time += start.elapsed();
            let time_s = f64::from(view.image_id) / splits.fps;
            let start = Clock::now();
            let guide = follower.guide(time_s, &world_from_camera, &selection);
            let frame = Frame { selection: &selection, guide: Some(&guide), ..Frame::new(&image, &view.camera) };
            let estimate = estimator.estimate_frame(&frame)?;
            let tracked = follower.take(time_s, &world_from_camera, &guide, &estimate)?;
            stream_time += start.elapsed();
            done.detected += usize::from(guide.detect);
            let single: Vec<(String, Pose)> = alone
                .poses
                .iter()
                .filter_map(|pose| {
                    Some((pose.object.clone(), world_from_camera * pose.pose.as_ref()?.camera_from_object))
                })
                .collect();
            done.astray += self.note(&view, &world_from_camera, &single, &tracked, &mut instances)?;
        }
        (done.single_s, done.stream_s) = (single_time.as_secs_f64(), stream_time.as_secs_f64());
        for (object, known) in self.known.iter().enumerate() {
            let of_object: Vec<Vec<Instant>> =
                instances.iter().filter(|((of, _), _)| *of == object).map(|(_, instants)| instants.clone()).collect();
            if let Some(score) = StreamScore::of(&known.points, &of_object) {
                done.objects.push((self.asked.objects[object].clone(), score));
            }
        }
        Ok(done)
    }

    /// What one image showed of each instance; how many live tracks are at none.
    fn note(
        &self,
        view: &View,
        world_from_camera: &Pose,
        single: &[(String, Pose)],
        tracked: &[Tracked],
        instances: &mut BTreeMap<Key, Vec<Instant>>,
    ) -> Result<usize, Box<dyn Error>> {
        let mut astray = 0;
        for (object, (name, known)) in self.asked.objects.iter().zip(self.known).enumerate() {
            let truths = view.truths(known.obj_id)?;
            let places: Vec<Pose> = truths.iter().map(|truth| *world_from_camera * truth.camera_from_object).collect();
            let limit_m = AT * known.points.diameter_m();
            let at = |poses: &[Pose]| {
                let distance_m = |pose: usize, place: usize| {
                    let apart = (poses[pose].translation() - places[place].translation()).norm();
                    Some(apart).filter(|apart| *apart <= limit_m)
                };
                assign(poses.len(), places.len(), distance_m)
            };
            let live: Vec<&Tracked> =
                tracked.iter().filter(|one| one.object == *name && one.view.state != TrackState::Lost).collect();
            let of_tracks = at(&live.iter().map(|one| one.view.world_from_object).collect::<Vec<_>>());
            let alone: Vec<Pose> = single.iter().filter(|(of, _)| of == name).map(|(_, pose)| *pose).collect();
            let of_single = at(&alone);
            astray += of_tracks.iter().filter(|place| place.is_none()).count();
            for (place, truth) in truths.iter().enumerate() {
                let seen = visible_fraction(truth);
                let counts = self.asked.splits.visible().iter().any(|range| range.contains(seen));
                if truth.bounding_box.is_none() || !counts {
                    continue;
                }
                let followed = of_tracks.iter().position(|of| *of == Some(place)).map(|one| Followed {
                    id: live[one].view.id,
                    pose: live[one].view.world_from_object,
                    covariance: live[one].view.covariance,
                });
                let single = of_single.iter().position(|of| *of == Some(place)).map(|one| alone[one]);
                let instant = Instant { truth: places[place], followed, single };
                instances.entry((object, truth.place)).or_default().push(instant);
            }
        }
        Ok(astray)
    }
}

impl Replayed {
    fn nothing_of(scene: &Scene, images: usize) -> Self {
        let name = scene.path.file_name().unwrap_or(scene.path.as_os_str());
        let scene = name.to_string_lossy().into_owned();
        Self { scene, images, single_s: 0.0, stream_s: 0.0, detected: 0, astray: 0, objects: Vec::new() }
    }
}
