//! Objects in the images of a batch, each through its network to poses; side by side where cores are idle.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use fast_image_resize::Resizer;

use super::answer::{EstimateError, KeypointPrediction, ObjectPose};
use super::cores::Cores;
use super::expected::Found;
use super::frame::Frame;
use super::gates::object_pose;
use super::keypoints::{self, Crops};
use super::watchdog::Activity;
use crate::model::{KeypointNet, ObjectModel};
use posed_core::calibration::Offset;
use posed_core::geometry::Camera;

/// An image with what was found in it.
pub(super) struct Scene<'a> {
    /// Among the images of the batch.
    pub place: usize,
    pub frame: &'a Frame<'a>,
    pub camera: &'a Camera,
    pub found: &'a [Found],
}

/// One object that some of the images show.
pub(super) struct Sought<'a> {
    /// In the library.
    pub index: usize,
    pub model: &'a ObjectModel,
    pub offset: &'a Offset,
    pub network: &'a mut KeypointNet,
}

/// What became of one box.
pub(super) struct Solved {
    object: usize,
    pub place: usize,
    pub pose: Result<ObjectPose, EstimateError>,
    /// Of all boxes of its image with the first of them.
    pub keypoints: Duration,
    pub pnp: Duration,
}

/// One box whose keypoints are wanted.
struct BoxInScene<'a> {
    scene: &'a Scene<'a>,
    found: Found,
}

/// All objects in all images, in the order of the objects. An idle core takes the next object as this thread does.
pub(super) fn solve_all(
    sought: Vec<Sought<'_>>,
    scenes: &[Scene<'_>],
    cores: &Cores,
    resizer: &mut Resizer,
    activity: &Activity,
) -> Vec<Solved> {
    let start = Instant::now();
    let lent = cores.borrow(sought.len().saturating_sub(1));
    let left = Mutex::new(sought.into_iter());
    let next = || left.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = |resizer: &mut Resizer| -> Vec<Solved> {
        std::iter::from_fn(next).flat_map(|object| object.solve(scenes, resizer, activity)).collect()
    };
    let mut solved = std::thread::scope(|scope| {
        let help = || std::thread::Builder::new().spawn_scoped(scope, || work(&mut Resizer::new()));
        // Where the system gives no thread, the work is done here.
        let helpers: Vec<_> = (0..lent.count).map_while(|_| help().ok()).collect();
        let mut solved = work(resizer);
        for helper in helpers {
            solved.extend(helper.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        solved
    });
    solved.sort_by_key(|one| one.object);
    share_time(&mut solved, start.elapsed());
    solved
}

/// What was done side by side is said to have taken its share of the time that passed.
fn share_time(solved: &mut [Solved], passed: Duration) {
    let worked: Duration = solved.iter().map(|one| one.keypoints + one.pnp).sum();
    let share = passed.as_secs_f64() / worked.as_secs_f64();
    if share < 1.0 {
        for one in solved {
            one.keypoints = one.keypoints.mul_f64(share);
            one.pnp = one.pnp.mul_f64(share);
        }
    }
}

impl Sought<'_> {
    fn solve(self, scenes: &[Scene<'_>], resizer: &mut Resizer, activity: &Activity) -> Vec<Solved> {
        let start = Instant::now();
        let object = self.index;
        let failed =
            |place, error| Solved { object, place, pose: Err(error), keypoints: Duration::ZERO, pnp: Duration::ZERO };
        let (mut wanted, mut crops, mut solved) = (Vec::new(), Vec::new(), Vec::new());
        for scene in scenes {
            let found: Vec<Found> = scene.found.iter().filter(|f| f.detection.object == object).copied().collect();
            if found.is_empty() {
                continue;
            }
            match self.cut(scene.frame, &found, resizer) {
                Ok(cut) => {
                    wanted.extend(found.into_iter().map(|found| BoxInScene { scene, found }));
                    crops.extend(cut);
                }
                Err(error) => solved.push(failed(scene.place, error)),
            }
        }
        if wanted.is_empty() {
            return solved;
        }
        let _running = activity.runs(&format!("the keypoint net of object {}", self.model.manifest.name));
        let predictions = locate(self.model, self.network, resizer, &wanted, &crops);
        let elapsed = start.elapsed();
        let mut timed = None;
        for (BoxInScene { scene, found }, prediction) in wanted.into_iter().zip(predictions) {
            let start = Instant::now();
            let pose = prediction.map(|prediction| {
                let image = scene.frame.image;
                let pose = object_pose(self.model, self.offset, found.detection, &prediction, image, scene.camera);
                ObjectPose { track: found.expected.map(|place| place.track), ..pose }
            });
            let is_first = timed.replace(scene.place) != Some(scene.place);
            let keypoints = if is_first { elapsed } else { Duration::ZERO };
            solved.push(Solved { object, place: scene.place, pose, keypoints, pnp: start.elapsed() });
        }
        solved
    }

    /// The crops of an image that is still wanted.
    fn cut<'a>(
        &self,
        frame: &Frame<'a>,
        found: &[Found],
        resizer: &mut Resizer,
    ) -> Result<Vec<Crops<'a>>, EstimateError> {
        (frame.abandoned)()?;
        let manifest = &self.model.manifest;
        let cut = |one: &Found| match one.expected {
            Some(place) => keypoints::cut_expected(manifest, resizer, frame.image, place.square),
            None => keypoints::cut(manifest, resizer, frame.image, one.detection.bounding_box),
        };
        Ok(found.iter().map(cut).collect::<Result<Vec<_>, _>>()?)
    }
}

/// The keypoints within boxes, of all images together. Where that fails, of each image alone: what fails then is that
/// image's own failure.
fn locate(
    model: &ObjectModel,
    network: &mut KeypointNet,
    resizer: &mut Resizer,
    boxes: &[BoxInScene<'_>],
    crops: &[Crops<'_>],
) -> Vec<Result<KeypointPrediction, EstimateError>> {
    let mut of = |crops: &[Crops<'_>]| keypoints::locate(&model.manifest, network, resizer, crops);
    let each = |count: usize, result: Result<Vec<_>, EstimateError>| match result {
        Ok(found) => found.into_iter().map(Ok).collect(),
        Err(error) => vec![Err(error); count],
    };
    let together = of(crops);
    let images = || boxes.chunk_by(|a, b| a.scene.place == b.scene.place);
    if together.is_ok() || images().count() == 1 {
        return each(crops.len(), together);
    }
    let mut rest = crops;
    let alone = |of_image: &[BoxInScene<'_>]| {
        let (own, others) = rest.split_at(of_image.len());
        rest = others;
        each(own.len(), of(own))
    };
    images().flat_map(alone).collect()
}
