//! A stream that tracks against single images of the same film, in turns. Writes a table in Markdown to the path in
//! `POSED_BENCH_OUT`, or prints it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed measurement is no measurement")]

#[path = "../support/numbers.rs"]
mod numbers;
#[path = "../support/process.rs"]
mod process;

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use posed::evaluation::{ReadOptions, SceneFolder, View};
use posed::proto::estimate_request::Camera as CameraChoice;
use posed::proto::estimate_stream_request::Kind;
use posed::proto::estimate_stream_response::Result as FrameResult;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{Camera, EstimateRequest, EstimateStreamRequest, Frame, StreamSettings, Transform};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use numbers::{median, spread};
use process::Server;

/// Images of a round, of each kind, and rounds: the machine is not equally fast from one minute to the next.
const ROUND: usize = 12;
const ROUNDS: usize = 20;

type Responses = Streaming<posed::proto::EstimateStreamResponse>;

fn main() {
    std::env::set_current_dir(env!("CARGO_MANIFEST_DIR")).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(measure());
}

/// The film in `POSED_FILM`, a BOP scene, or the one of the tests.
fn film() -> Vec<View> {
    let scene = std::env::var("POSED_FILM").unwrap_or_else(|_| "tests/data/film/000001".into());
    let options = ReadOptions::default();
    let scene = SceneFolder::at(Path::new(&scene), &options).unwrap().read(&options).unwrap();
    scene.image_ids().map(|image_id| scene.view(image_id).unwrap()).collect()
}

fn request(view: &View) -> EstimateRequest {
    let world = view.world_from_camera.as_ref().unwrap();
    let [rotation_x, rotation_y, rotation_z, rotation_w] = world.rotation_xyzw();
    let [translation_x_m, translation_y_m, translation_z_m] = world.translation_m();
    let (focal, centre) = (view.camera.focal(), view.camera.principal_point());
    let camera = Camera { fx: focal.x, fy: focal.y, cx: centre.x, cy: centre.y, ..Camera::default() };
    EstimateRequest {
        image: std::fs::read(&view.image).unwrap().into(),
        camera: Some(CameraChoice::InlineCamera(camera)),
        objects: vec!["cube".into()],
        world_from_camera: Some(Transform {
            rotation_x,
            rotation_y,
            rotation_z,
            rotation_w,
            translation_x_m,
            translation_y_m,
            translation_z_m,
        }),
        ..EstimateRequest::default()
    }
}

async fn open(server: &Server, settings: StreamSettings) -> (mpsc::Sender<EstimateStreamRequest>, Responses) {
    let (requests, receiver) = mpsc::channel(ROUND);
    requests.send(EstimateStreamRequest { kind: Some(Kind::Settings(settings)) }).await.unwrap();
    let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let responses = client.estimate_stream(ReceiverStream::new(receiver)).await.unwrap().into_inner();
    (requests, responses)
}

/// A round: all frames at once, so that the server never waits for its client. Seconds.
async fn round(
    requests: &mpsc::Sender<EstimateStreamRequest>,
    responses: &mut Responses,
    frames: Vec<Frame>,
    delays_ms: &mut Vec<f64>,
) -> f64 {
    let (start, count) = (Instant::now(), frames.len());
    for frame in frames {
        requests.send(EstimateStreamRequest { kind: Some(Kind::Frame(frame)) }).await.unwrap();
    }
    for _ in 0..count {
        let response = responses.message().await.unwrap().unwrap();
        let Some(FrameResult::Answer(answer)) = response.result else { panic!("a frame failed") };
        assert!(!answer.poses.is_empty(), "the cube is in view");
        delays_ms.push(answer.timings.map_or(f64::NAN, |timings| timings.total_ms));
    }
    start.elapsed().as_secs_f64()
}

async fn measure() {
    let views = film();
    let server = Server::start(&[]).await;
    let (single, mut single_answers) = open(&server, StreamSettings::default()).await;
    let (tracked, mut tracked_answers) = open(&server, StreamSettings { track: true, ..Default::default() }).await;
    let (mut single_rates, mut tracked_rates, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    let (mut single_ms, mut tracked_ms) = (Vec::new(), Vec::new());
    let mut time = 0.0;
    // The film to and fro, so that no frame is far from the one before it.
    let there = views.iter().chain(views.iter().rev()).cycle();
    let images: Vec<&View> = there.take(ROUNDS * ROUND).collect();
    for some in images.chunks_exact(ROUND) {
        let frames = |times: &mut dyn FnMut() -> Option<f64>| -> Vec<Frame> {
            let frame = |view: &&View| Frame { frame_id: 0, request: Some(request(view)), capture_time: times() };
            some.iter().map(frame).collect()
        };
        let alone = frames(&mut || None);
        let seconds = round(&single, &mut single_answers, alone, &mut single_ms).await;
        let mut next = || {
            time += 1.0 / 30.0;
            Some(time)
        };
        let together = frames(&mut next);
        let tracked_seconds = round(&tracked, &mut tracked_answers, together, &mut tracked_ms).await;
        single_rates.push(ROUND as f64 / seconds);
        tracked_rates.push(ROUND as f64 / tracked_seconds);
        ratios.push(seconds / tracked_seconds);
    }
    let text = report(images.len(), [&single_rates, &tracked_rates, &ratios], [&single_ms, &tracked_ms]);
    print!("{text}");
    if let Some(path) = std::env::var_os("POSED_BENCH_OUT") {
        std::fs::write(Path::new(&path), text).unwrap();
    }
}

fn report(images: usize, [single, tracked, ratios]: [&[f64]; 3], [single_ms, tracked_ms]: [&[f64]; 2]) -> String {
    let mut text = String::new();
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    writeln!(
        text,
        "# Tracking: rate\n\n`make bench-track`: `EstimateStream` of the real server with and without `track`, in turns of {ROUND} \
         images, {images} of each; one object, one worker, {cores} cores that server and client share. Medians; the ratio is that \
         of neighbours.\n\n| | single images | tracked |\n|---|---|---|"
    )
    .unwrap();
    writeln!(text, "| images/s | {:.1} | {:.1} |", median(single), median(tracked)).unwrap();
    writeln!(text, "| ms from arrival to answer, p50 / p99 / most | {} | {} |", spread(single_ms), spread(tracked_ms))
        .unwrap();
    writeln!(text, "| ratio of the rates | | **{:.2}** |", median(ratios)).unwrap();
    text
}
