//! The bounded queue and its workers.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};
use posed::estimator::{Abandoned, Queue, QueueConfig, QueueError, Refusal, Room, Selection, StartError, Work};
use posed::model::{Input, RuntimeError};
use posed::vision::{DecodeOptions, Image, header};

use crate::script::{Manifests, Models, Script, batch_of, brightness, camera, end2end, keypoints, output, png};

const ROOM: Room = Room { images: 16, bytes: 1 << 20, pixel_bytes: 1 << 26 };
pub(crate) const CONFIG: QueueConfig = QueueConfig {
    room: ROOM,
    decoders: 2,
    workers: 1,
    max_batch: 8,
    batch_delay: Duration::ZERO,
    worker_timeout: Duration::from_mins(10),
    decode: DecodeOptions {
        max_side_px: 1000,
        max_pixels: 1_000_000,
        exif_orientation: posed::vision::OrientationPolicy::Refuse,
    },
};
const LONG: Duration = Duration::from_mins(1);
/// Images of this brightness are the script's cue; others, and the warm-up's, run through.
const CUE: u8 = 77;

fn work(brightness: u8, time: Duration) -> Work {
    let selection = Selection::ALL;
    Work {
        image: Image::Encoded(png(brightness).into()),
        body: None,
        camera: camera(),
        selection,
        guide: None,
        keep_image: false,
        deadline: Instant::now() + time,
    }
}

fn start(config: QueueConfig, script: Script) -> Queue {
    let models = Models::new(&Manifests::default(), script);
    Queue::start(config, move || models.estimator()).unwrap()
}

/// A detector that stops at each image of brightness [`CUE`]: it says that it has come there, and waits to be let on.
fn gated() -> (Script, Receiver<()>, Sender<()>) {
    let ((arrive, arrivals), (open, gate)) = (crossbeam_channel::unbounded(), crossbeam_channel::unbounded());
    let detector = Arc::new(move |input: Input<'_>| {
        if brightness(input) == CUE {
            arrive.send(()).unwrap();
            // A closed gate lets everything through.
            let _ = gate.recv();
        }
        Ok(vec![end2end()])
    });
    (Script { detector, ..Script::default() }, arrivals, open)
}

/// Puts an image into the queue and comes back once it is there.
async fn enqueue(queue: &Queue, work: Work) -> tokio::task::JoinHandle<Result<usize, QueueError>> {
    let admitted = queue.stats().admitted.load(Ordering::Relaxed);
    let (of_task, stats) = (queue.clone(), queue.clone());
    let task = tokio::spawn(async move { of_task.estimate(work).await.map(|answer| answer.batch_size) });
    while stats.stats().admitted.load(Ordering::Relaxed) == admitted {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    task
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_is_answered_and_the_worker_comes_back() {
    let script = Script {
        detector: Arc::new(|input: Input<'_>| {
            assert!(brightness(input) != CUE, "scripted fault");
            Ok(vec![end2end()])
        }),
        ..Script::default()
    };
    let loads = Arc::clone(&script.loads);
    let queue = start(CONFIG, script);
    let loaded = loads.load(Ordering::Relaxed);
    assert!(queue.estimate(work(10, LONG)).await.is_ok());
    assert!(matches!(queue.estimate(work(CUE, LONG)).await, Err(QueueError::Crashed)));
    for _ in 0..3 {
        assert_eq!(queue.estimate(work(10, LONG)).await.unwrap().estimate.poses.len(), 1);
    }
    assert_eq!(queue.stats().worker_restarts.load(Ordering::Relaxed), 1);
    assert_eq!(loads.load(Ordering::Relaxed), 2 * loaded, "the networks were loaded again");
    assert_eq!(queue.admission().images(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_network_that_fails_spoils_only_the_images_that_need_it() {
    let failing = || RuntimeError::Run { name: "scripted".into(), reason: "no memory".into() };
    let detector = Arc::new(|input: Input<'_>| {
        let nothing = output("detections", &[1, 0, 6], Vec::new());
        Ok(vec![if brightness(input) == 10 { nothing } else { end2end() }])
    });
    let keypoints_net =
        Arc::new(
            move |input: Input<'_>| {
                if brightness(input) == CUE { Err(failing()) } else { Ok(keypoints(batch_of(input))) }
            },
        );
    let queue = start(CONFIG, Script { detector, keypoints: keypoints_net, ..Script::default() });
    let message = queue.estimate(work(CUE, LONG)).await.unwrap_err().to_string();
    assert!(message.contains("no memory"), "{message}");
    assert!(queue.estimate(work(10, LONG)).await.unwrap().estimate.poses.is_empty());
    assert_eq!(queue.estimate(work(20, LONG)).await.unwrap().estimate.poses.len(), 1);
    assert_eq!(queue.stats().worker_restarts.load(Ordering::Relaxed), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_queue_is_bounded_by_count() {
    let (script, arrivals, gate) = gated();
    let queue = start(QueueConfig { room: Room { images: 3, ..ROOM }, ..CONFIG }, script);
    let mut waiting = Vec::new();
    for _ in 0..3 {
        waiting.push(enqueue(&queue, work(CUE, LONG)).await);
    }
    arrivals.recv().unwrap();
    assert!(matches!(queue.estimate(work(10, LONG)).await, Err(QueueError::Refused(Refusal::Images { limit: 3 }))));
    drop(gate);
    for task in waiting {
        assert!(task.await.unwrap().is_ok());
    }
    assert!(queue.estimate(work(10, LONG)).await.is_ok());
    assert_eq!(queue.stats().refused.load(Ordering::Relaxed), 1);
}

/// Bytes are held until an image is decoded, which waits until there is room for its pixels.
#[tokio::test(flavor = "multi_thread")]
async fn the_queue_is_bounded_by_bytes_and_pixels() {
    let (script, arrivals, gate) = gated();
    let image = Image::Encoded(png(CUE).into());
    let size = image.byte_count();
    let to_decode = usize::try_from(header(&image, &CONFIG.decode).unwrap().decode_bytes).unwrap();
    let room = Room { bytes: 2 * size + size / 2, pixel_bytes: to_decode, ..ROOM };
    let queue = start(QueueConfig { room, ..CONFIG }, script);
    let first = enqueue(&queue, work(CUE, LONG)).await;
    arrivals.recv().unwrap();
    // The first one's pixels are in work: the next two wait for theirs, and hold their bytes.
    let second = enqueue(&queue, work(10, LONG)).await;
    let third = enqueue(&queue, work(10, LONG)).await;
    let refused = queue.estimate(work(CUE, LONG)).await;
    assert!(matches!(refused, Err(QueueError::Refused(Refusal::Bytes { .. }))), "{refused:?}");
    // One that has no time to wait for pixels is told so.
    drop(third);
    let hurried = queue.estimate(work(10, Duration::from_millis(30))).await;
    assert!(matches!(hurried, Err(QueueError::Refused(_) | QueueError::Abandoned(Abandoned::Expired))), "{hurried:?}");
    drop(gate);
    assert!(first.await.unwrap().is_ok() && second.await.unwrap().is_ok());
    assert!(queue.estimate(work(10, LONG)).await.is_ok());
    assert_eq!(queue.admission().bytes(), 0);
    // What there will never be room for is told so at once.
    let room = Room { pixel_bytes: to_decode - 1, ..ROOM };
    let small = start(QueueConfig { room, ..CONFIG }, Script::default());
    assert!(matches!(small.estimate(work(10, LONG)).await, Err(QueueError::TooCostly { .. })));
}

/// What cannot be decoded is its own caller's matter, and gives its room back.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_image_takes_no_room() {
    let queue = start(CONFIG, Script::default());
    for _ in 0..2 * ROOM.images {
        let broken = Work { image: Image::Encoded(vec![0xFF; 100].into()), ..work(10, LONG) };
        assert!(matches!(queue.estimate(broken).await, Err(QueueError::Decode(_))));
    }
    assert!(queue.estimate(work(10, LONG)).await.is_ok());
    assert_eq!((queue.admission().images(), queue.admission().bytes()), (0, 0));
    assert_eq!(queue.stats().undecodable.load(Ordering::Relaxed), 2 * ROOM.images as u64);
}

/// While the worker is busy one batch is prepared; the images behind it are worked on together, and all crops of a batch
/// go through the keypoint net at once. How many made it into the prepared batch is a matter of luck.
#[tokio::test(flavor = "multi_thread")]
async fn waiting_images_are_worked_on_together() {
    let (script, arrivals, gate) = gated();
    let batches = Arc::new(Mutex::new(Vec::new()));
    let of_net = Arc::clone(&batches);
    let keypoints_net = Arc::new(move |input: Input<'_>| {
        of_net.lock().unwrap().push(batch_of(input));
        Ok(keypoints(batch_of(input)))
    });
    let queue = start(CONFIG, Script { keypoints: keypoints_net, ..script });
    batches.lock().unwrap().clear(); // the warm-up's
    let mut tasks = vec![enqueue(&queue, work(CUE, LONG)).await];
    arrivals.recv().unwrap();
    for _ in 0..4 {
        tasks.push(enqueue(&queue, work(10, LONG)).await);
    }
    drop(gate);
    let mut sizes = Vec::new();
    for task in tasks {
        sizes.push(task.await.unwrap().unwrap());
    }
    let batches = batches.lock().unwrap();
    assert_eq!((batches[0], batches.iter().sum::<usize>()), (1, 5));
    assert!(batches.len() <= 3, "{batches:?}");
    let of_images: Vec<usize> = batches.iter().flat_map(|size| vec![*size; *size]).collect();
    assert_eq!(sizes, of_images);
}

/// The caller is answered at its deadline although the worker is stuck, and its image is not worked on afterwards.
#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_holds_whatever_the_worker_does() {
    let (script, arrivals, gate) = gated();
    let runs = Arc::new(AtomicUsize::new(0));
    let (of_net, inner) = (Arc::clone(&runs), Arc::clone(&script.detector));
    let detector = Arc::new(move |input: Input<'_>| {
        of_net.fetch_add(1, Ordering::Relaxed);
        inner(input)
    });
    let queue = start(CONFIG, Script { detector, ..script });
    let stuck = enqueue(&queue, work(CUE, LONG)).await;
    arrivals.recv().unwrap();
    let before = runs.load(Ordering::Relaxed);
    let hurried = queue.estimate(work(10, Duration::from_millis(30))).await;
    assert!(matches!(hurried, Err(QueueError::Abandoned(Abandoned::Expired))));
    let cancelled = enqueue(&queue, work(10, LONG)).await;
    cancelled.abort();
    assert!(cancelled.await.unwrap_err().is_cancelled());
    drop(gate);
    assert!(stuck.await.unwrap().is_ok());
    assert!(queue.estimate(work(20, LONG)).await.is_ok());
    assert_eq!(runs.load(Ordering::Relaxed), before + 1, "neither was worked on");
    assert_eq!(queue.stats().expired.load(Ordering::Relaxed), 1);
    assert_eq!(queue.stats().cancelled.load(Ordering::Relaxed), 1);
}

/// Whoever leaves or runs out of time while the worker is busy with others leaves place and pixels to the next one at once.
#[tokio::test(flavor = "multi_thread")]
async fn who_no_longer_waits_takes_no_room() {
    let (script, arrivals, gate) = gated();
    let image = Image::Encoded(png(CUE).into());
    let to_decode = usize::try_from(header(&image, &CONFIG.decode).unwrap().decode_bytes).unwrap();
    let queue = start(QueueConfig { room: Room { images: 3, pixel_bytes: 3 * to_decode, ..ROOM }, ..CONFIG }, script);
    let stuck = enqueue(&queue, work(CUE, LONG)).await;
    arrivals.recv().unwrap();
    for _ in 0..4 {
        let leaving = [enqueue(&queue, work(10, LONG)).await, enqueue(&queue, work(10, LONG)).await];
        // Decoded images hold no bytes any more; then they wait for the worker.
        while queue.admission().bytes() > 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
        assert!(queue.admission().has_place().is_err());
        for task in leaving {
            task.abort();
            assert!(task.await.unwrap_err().is_cancelled());
        }
        assert_eq!(queue.admission().images(), 1);
        let hurried = queue.estimate(work(10, Duration::from_millis(100))).await;
        assert!(matches!(hurried, Err(QueueError::Abandoned(Abandoned::Expired))), "{hurried:?}");
        assert_eq!(queue.admission().images(), 1);
    }
    let patient = enqueue(&queue, work(10, LONG)).await;
    drop(gate);
    assert!(stuck.await.unwrap().is_ok() && patient.await.unwrap().is_ok());
    assert_eq!(queue.stats().cancelled.load(Ordering::Relaxed), 8);
    assert_eq!(queue.stats().expired.load(Ordering::Relaxed), 4);
}

/// Between the stages, too: an image whose time is over after detection costs no keypoint net.
#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_is_kept_between_the_stages() {
    let (script, arrivals, gate) = gated();
    let runs = Arc::new(AtomicUsize::new(0));
    let of_net = Arc::clone(&runs);
    let keypoints_net = Arc::new(move |input: Input<'_>| {
        of_net.fetch_add(1, Ordering::Relaxed);
        Ok(keypoints(batch_of(input)))
    });
    let queue = start(CONFIG, Script { keypoints: keypoints_net, ..script });
    let before = runs.load(Ordering::Relaxed);
    let hurried = queue.estimate(work(CUE, Duration::from_millis(700))).await;
    assert!(matches!(hurried, Err(QueueError::Abandoned(Abandoned::Expired))));
    arrivals.recv().unwrap();
    drop(gate);
    assert!(queue.estimate(work(10, LONG)).await.is_ok());
    assert_eq!(runs.load(Ordering::Relaxed), before + 1);
}

/// What its predecessors took says that an image cannot be in time: its caller hears so while the worker is still busy.
#[tokio::test(flavor = "multi_thread")]
async fn what_must_come_late_is_refused_at_once() {
    let (script, arrivals, gate) = gated();
    let queue = start(CONFIG, script);
    let measured = enqueue(&queue, work(CUE, LONG)).await;
    arrivals.recv().unwrap();
    std::thread::sleep(Duration::from_millis(400));
    gate.send(()).unwrap();
    assert!(measured.await.unwrap().is_ok());
    let stuck = enqueue(&queue, work(CUE, LONG)).await;
    arrivals.recv().unwrap();
    let hasty = queue.estimate(work(10, Duration::from_millis(200))).await;
    assert!(matches!(hasty, Err(QueueError::Refused(Refusal::Hasty { .. }))), "{hasty:?}");
    let behind = queue.estimate(work(10, Duration::from_millis(600))).await;
    assert!(matches!(behind, Err(QueueError::Refused(Refusal::Busy { .. }))), "{behind:?}");
    assert!(queue.may_come(Instant::now() + Duration::from_millis(600)).is_err());
    let patient = enqueue(&queue, work(10, LONG)).await;
    drop(gate);
    assert!(stuck.await.unwrap().is_ok() && patient.await.unwrap().is_ok());
    assert_eq!(queue.admission().images(), 0);
}

/// Nobody waits for a network that hangs; and if it ends after all its worker goes on.
#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_hangs_is_taken_out_until_it_comes_back() {
    let (script, arrivals, gate) = gated();
    let queue = start(QueueConfig { worker_timeout: Duration::from_millis(100), ..CONFIG }, script);
    let until_ready = async |workers: usize| {
        while queue.stats().ready_workers.load(Ordering::Relaxed) != workers {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    let stuck = enqueue(&queue, work(CUE, LONG)).await;
    arrivals.recv().unwrap();
    until_ready(0).await;
    let refused = queue.estimate(work(10, LONG)).await;
    assert!(matches!(refused, Err(QueueError::Refused(Refusal::NoWorkers))), "{refused:?}");
    drop(gate);
    assert!(stuck.await.unwrap().is_ok());
    until_ready(1).await;
    assert!(queue.estimate(work(10, LONG)).await.is_ok());
    assert_eq!(queue.stats().worker_timeouts.load(Ordering::Relaxed), 1);
}

/// The other worker is up and waits for work: the start must not wait for it.
#[test]
fn a_panic_of_one_worker_while_it_starts_is_said() {
    let models = Models::new(&Manifests::default(), Script::default());
    let made = AtomicUsize::new(0);
    let make = move || {
        assert!(made.fetch_add(1, Ordering::Relaxed) == 0, "scripted fault");
        models.estimator()
    };
    let (say, heard) = crossbeam_channel::unbounded();
    std::thread::spawn(move || say.send(Queue::start(QueueConfig { workers: 2, ..CONFIG }, make).map(drop)));
    let failed = heard.recv_timeout(LONG).unwrap();
    assert!(matches!(failed, Err(StartError::Panicked)), "{failed:?}");
}

#[test]
fn networks_that_do_not_run_are_found_before_anybody_waits() {
    let detector = Arc::new(|_: Input<'_>| Ok(Vec::new()));
    let models = Models::new(&Manifests::default(), Script { detector, ..Script::default() });
    let failed = Queue::start(CONFIG, move || models.estimator());
    assert!(matches!(failed, Err(StartError::WarmUp(_))));
}
