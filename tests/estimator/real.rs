//! The shipped networks.

use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use posed::estimator::{Estimate, Estimator, Frame, GivenBox, Queue, QueueConfig, Selection, Work};
use posed::model::{
    Backend, Input, Library, LoadOptions, Network, Outputs, Provider, References, Runtime, RuntimeError,
};
use posed::vision::{BoundingBox, DecodeOptions, Image, decode};
use posed_core::geometry::{Camera, Pose};
use posed_core::pnp::Status;

use crate::queue::CONFIG;
use crate::script::runtime;

/// An answer does not depend on the images that it is worked on with: the arithmetic's order may differ in the last
/// digits of a float, and nothing else.
#[test]
fn an_answer_does_not_depend_on_its_batch() {
    let mut estimator = shipped(runtime());
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap();
    let images: Vec<_> =
        (1..=3).map(|index| decode(&sample(index), &DecodeOptions::default()).unwrap().image).collect();
    let frames: Vec<_> = images.iter().chain(&images).map(|image| Frame::new(image, &camera)).collect();
    let together = estimator.estimate_all(&frames);
    let mut poses = 0;
    for (frame, together) in frames.iter().zip(together) {
        poses += assert_same(&estimator.estimate(frame.image, &camera).unwrap(), &together.unwrap());
    }
    assert!(poses >= 12, "{poses}");
}

/// A worker that is alone with an image looks at two objects at once, with the core of one that waits; the answer is that of
/// one after the other.
#[tokio::test(flavor = "multi_thread")]
async fn an_idle_worker_lends_its_core() {
    let meeting = Arc::new(Meeting::default());
    let backend = Meeters { runtime: runtime(), meeting: Arc::clone(&meeting) };
    let config = QueueConfig { workers: 2, ..CONFIG };
    let queue = Queue::start(config, move || Ok(shipped(&backend))).unwrap();
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap();
    meeting.call(2);
    let work = Work {
        image: sample(1),
        body: None,
        camera: camera.clone(),
        selection: Selection::ALL,
        guide: None,
        keep_image: false,
        deadline: Instant::now() + Duration::from_mins(1),
    };
    let answer = queue.estimate(work).await.unwrap().estimate;
    let image = decode(&sample(1), &DecodeOptions::default()).unwrap().image;
    let alone = shipped(runtime()).estimate(&image, &camera).unwrap();
    assert_eq!(assert_same(&alone, &answer), 4);
    assert!(meeting.has_met(), "two keypoint nets never ran at once");
}

/// The detector puts a tight and a loose box about the bracket of the second sample: they are one bracket. Boxes that a caller
/// gives are his to count: each has its answer.
#[test]
fn what_is_boxed_twice_is_answered_once() {
    let mut estimator = shipped(runtime());
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap();
    let image = decode(&sample(2), &DecodeOptions::default()).unwrap().image;
    let answer = estimator.estimate(&image, &camera).unwrap();
    let mut names: Vec<&str> = answer.poses.iter().map(|pose| pose.object.as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["bracket", "cube", "link", "motor"]);
    let bracket = answer.poses.iter().find(|pose| pose.object == "bracket").unwrap();
    assert_eq!(bracket.verdict.status, Status::Ok, "the better of both");

    let tight = bracket.detection.bounding_box;
    let loose = BoundingBox { width: 1.3 * tight.width, height: 1.3 * tight.height, ..tight };
    let given = [tight, loose].map(|region| GivenBox { object: "bracket".into(), region });
    let selection = Selection { boxes: Some(given.into()), ..Selection::ALL };
    let frame = Frame { selection: &selection, ..Frame::new(&image, &camera) };
    let poses = estimator.estimate_frame(&frame).unwrap().poses;
    assert_eq!(poses.len(), 2);
}

/// Networks that wait for each other.
#[derive(Default)]
struct Meeting {
    missing: Mutex<usize>,
    changed: Condvar,
}

impl Meeting {
    /// From now on runs wait until so many have begun.
    fn call(&self, count: usize) {
        *self.missing.lock().unwrap() = count;
    }

    fn attend(&self) {
        let mut missing = self.missing.lock().unwrap();
        *missing = missing.saturating_sub(1);
        self.changed.notify_all();
        let waited = self.changed.wait_timeout_while(missing, Duration::from_secs(10), |missing| *missing > 0);
        let (mut missing, timeout) = waited.unwrap();
        // Nobody came: it was here alone.
        *missing += usize::from(timeout.timed_out());
    }

    fn has_met(&self) -> bool {
        *self.missing.lock().unwrap() == 0
    }
}

/// The runtime, whose keypoint nets meet.
struct Meeters {
    runtime: &'static Runtime,
    meeting: Arc<Meeting>,
}

struct Meeter(Box<dyn Network>, Arc<Meeting>);

impl Network for Meeter {
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError> {
        self.1.attend();
        self.0.run(input)
    }
}

impl Backend for Meeters {
    fn load(&self, name: &str, bytes: &[u8], options: LoadOptions<'_>) -> Result<Box<dyn Network>, RuntimeError> {
        let network = self.runtime.load(name, bytes, options)?;
        let is_detector = name.contains("detector");
        Ok(if is_detector { network } else { Box::new(Meeter(network, Arc::clone(&self.meeting))) })
    }

    fn provider(&self) -> Provider {
        self.runtime.provider()
    }
}

fn shipped(backend: &dyn Backend) -> Estimator {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let library = Arc::new(Library::load(&root.join("models")).unwrap());
    let references = Arc::new(References::load(&root.join("reference"), &library).unwrap());
    Estimator::new(library, references, backend).unwrap()
}

fn sample(number: usize) -> Image {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    Image::Encoded(std::fs::read(root.join(format!("samples/sample-{number}.jpg"))).unwrap().into())
}

/// How many poses two answers have, which are the same.
fn assert_same(one: &Estimate, other: &Estimate) -> usize {
    let (one, other) = (summary(one), summary(other));
    assert_eq!(one.len(), other.len());
    for ((object, status, pose), (other_object, other_status, other)) in one.iter().zip(&other) {
        assert_eq!((object, status), (other_object, other_status));
        assert!(pose.angle_to(other) < 1e-4, "{object}: {}", pose.angle_to(other));
        let distance = (pose.translation() - other.translation()).norm();
        assert!(distance < 1e-5, "{object}: {distance}");
    }
    one.len()
}

fn summary(estimate: &Estimate) -> Vec<(String, String, Pose)> {
    let solved = estimate.poses.iter().filter_map(|found| Some((found, found.pose.as_ref()?)));
    solved.map(|(f, pose)| (f.object.clone(), f.verdict.status.to_string(), pose.camera_from_object)).collect()
}
