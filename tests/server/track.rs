//! `EstimateStream` with `track`: objects keep their ids from frame to frame.

use std::path::PathBuf;

use posed::evaluation::{ModelPoints, ObjectMesh, ReadOptions, SceneFolder, View};
use posed::proto::estimate_request::Camera as CameraChoice;
use posed::proto::estimate_stream_request::Kind;
use posed::proto::estimate_stream_response::Result as FrameResult;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{
    Camera, EstimateRequest, EstimateResponse, EstimateStreamRequest, EstimateStreamResponse, Frame, StreamSettings,
    Track, TrackSettings, TrackState, Transform,
};
use posed_core::geometry::Pose;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status, Streaming};

use crate::support::{Server, change, copy_of, png, read, root};

const CUBE: u32 = 1;
const MOTOR: u32 = 3;

/// Twelve images, ten a second, of a camera on its way past four objects; the cube slides.
fn film() -> Vec<View> {
    let scene = root().join("tests/data/film/000001");
    let scene = SceneFolder::at(&scene, &ReadOptions::default()).unwrap().read(&ReadOptions::default()).unwrap();
    scene.image_ids().map(|image_id| scene.view(image_id).unwrap()).collect()
}

/// The camera of the film.
fn camera() -> Camera {
    Camera { fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5, ..Camera::default() }
}

fn transform(pose: &Pose) -> Transform {
    let [rotation_x, rotation_y, rotation_z, rotation_w] = pose.rotation_xyzw();
    let [translation_x_m, translation_y_m, translation_z_m] = pose.translation_m();
    Transform { rotation_x, rotation_y, rotation_z, rotation_w, translation_x_m, translation_y_m, translation_z_m }
}

fn pose(transform: &Transform) -> Pose {
    let t = transform;
    let translation_m = [t.translation_x_m, t.translation_y_m, t.translation_z_m];
    Pose::from_quaternion_xyzw([t.rotation_x, t.rotation_y, t.rotation_z, t.rotation_w], translation_m).unwrap()
}

fn request(image: Vec<u8>, view: &View) -> EstimateRequest {
    EstimateRequest {
        image: image.into(),
        camera: Some(CameraChoice::InlineCamera(camera())),
        objects: vec!["cube".into(), "motor".into()],
        world_from_camera: Some(transform(view.world_from_camera.as_ref().unwrap())),
        ..EstimateRequest::default()
    }
}

fn tracking() -> StreamSettings {
    StreamSettings { track: true, ..StreamSettings::default() }
}

/// A stream that is asked and answered frame by frame.
struct Stream {
    requests: mpsc::Sender<EstimateStreamRequest>,
    responses: Streaming<EstimateStreamResponse>,
}

impl Stream {
    async fn open(server: &Server, settings: StreamSettings) -> Self {
        let (requests, receiver) = mpsc::channel(4);
        requests.send(EstimateStreamRequest { kind: Some(Kind::Settings(settings)) }).await.unwrap();
        let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
        let responses = client.estimate_stream(ReceiverStream::new(receiver)).await.unwrap().into_inner();
        Self { requests, responses }
    }

    async fn send(&mut self, request: EstimateRequest, capture_time: Option<f64>) -> EstimateStreamResponse {
        let frame = Frame { frame_id: 7, request: Some(request), capture_time };
        self.requests.send(EstimateStreamRequest { kind: Some(Kind::Frame(frame)) }).await.unwrap();
        self.responses.message().await.unwrap().unwrap()
    }

    /// The tracks of a frame that is answered.
    async fn tracks(&mut self, request: EstimateRequest, capture_time: f64) -> Vec<Track> {
        let response = self.send(request, Some(capture_time)).await;
        answer(&response);
        response.tracking.unwrap().tracks
    }

    /// What a frame that is not answered is told.
    async fn refused(&mut self, request: EstimateRequest, capture_time: Option<f64>) -> String {
        let response = self.send(request, capture_time).await;
        assert!(response.tracking.is_none());
        let Some(FrameResult::Error(error)) = response.result else { panic!("it is answered") };
        assert_eq!(error.code, Code::InvalidArgument as i32);
        error.message
    }
}

fn answer(response: &EstimateStreamResponse) -> &EstimateResponse {
    match response.result.as_ref().unwrap() {
        FrameResult::Answer(answer) => answer,
        FrameResult::Error(error) => panic!("{}", error.message),
    }
}

fn of<'a>(tracks: &'a [Track], object: &str) -> &'a Track {
    let mut found = tracks.iter().filter(|track| track.object == object);
    let track = found.next().unwrap_or_else(|| panic!("no track of {object}"));
    assert!(found.next().is_none(), "several tracks of {object}");
    track
}

/// ADD of a track over the diameter.
fn error(track: &Track, view: &View, obj_id: u32) -> f64 {
    let mesh = ObjectMesh::read(&root().join("training/demo/models"), obj_id).unwrap();
    let points = ModelPoints::new(&mesh).unwrap();
    let truth = view.truths(obj_id).unwrap()[0].camera_from_object;
    points.average_distance_m(&pose(track.camera_from_object.as_ref().unwrap()), &truth) / points.diameter_m()
}

fn image_of(view: &View) -> Vec<u8> {
    read(&PathBuf::from(&view.image))
}

fn grey() -> Vec<u8> {
    png(&image::RgbImage::from_pixel(320, 240, image::Rgb([120, 118, 121])).into())
}

#[tokio::test]
async fn objects_keep_their_ids_and_the_detector_rests() {
    let server = Server::start(&[]);
    let film = film();
    let settings = TrackSettings { detect_every: 6, ..TrackSettings::default() };
    let mut stream = Stream::open(&server, StreamSettings { tracking: Some(settings), ..tracking() }).await;
    let mut detected = Vec::new();
    for (frame, view) in film.iter().enumerate() {
        let time = 1e9 + 0.1 * frame as f64;
        let response = stream.send(request(image_of(view), view), Some(time)).await;
        let (answer, tracking) = (answer(&response), response.tracking.as_ref().unwrap());
        assert!((tracking.capture_time - time).abs() < 1e-6 && tracking.delay_ms > 0.0);
        detected.push(tracking.detected);
        assert_eq!(answer.timings.as_ref().unwrap().detect_ms > 0.0, tracking.detected);
        for (object, id, obj_id) in [("cube", 1, CUBE), ("motor", 2, MOTOR)] {
            let track = of(&tracking.tracks, object);
            // Which of the two is first is not said.
            assert!(track.track_id == id || track.track_id == 3 - id);
            let expected = if frame < 2 { TrackState::New } else { TrackState::Tracked };
            assert_eq!(track.state(), expected, "frame {frame}: {object}");
            assert!(error(track, view, obj_id) < 0.15, "frame {frame}: {object}");
            let measured = &answer.poses[track.pose.unwrap() as usize];
            assert_eq!(measured.object, object);
            assert_eq!((track.covariance.len(), track.velocity.len(), track.unseen_s), (36, 6, 0.0));
            assert!((track.age_s - 0.1 * frame as f64).abs() < 1e-6);
            let world = pose(track.world_from_object.as_ref().unwrap().transform.as_ref().unwrap());
            let there = *view.world_from_camera.as_ref().unwrap() * pose(track.camera_from_object.as_ref().unwrap());
            assert!((world.matrix() - there.matrix()).norm() < 1e-9);
        }
    }
    assert!(detected[0] && !detected[1] && detected.iter().filter(|detected| **detected).count() <= 3, "{detected:?}");
}

/// Of an object that the network sees too small, what is expected is as large as the network sees it.
#[tokio::test]
async fn a_scaled_object_is_expected_where_it_is_seen() {
    let film = film();
    let mut widths = Vec::new();
    for scale in [1.0, 1.2] {
        let reference = copy_of("reference");
        change(&reference.path().join("cube.json"), |json| json["keypoints_scale"] = scale.into());
        let server = Server::start(&["--reference", reference.path().to_str().unwrap()]);
        let mut stream = Stream::open(&server, tracking()).await;
        stream.tracks(request(image_of(&film[0]), &film[0]), 0.0).await;
        let response = stream.send(request(image_of(&film[1]), &film[1]), Some(0.1)).await;
        assert!(!response.tracking.as_ref().unwrap().detected);
        let cube = answer(&response).poses.iter().find(|pose| pose.object == "cube").unwrap();
        assert!((cube.solved.as_ref().unwrap().keypoints_scale - scale).abs() < 1e-9);
        widths.push(cube.r#box.unwrap().width_px);
    }
    assert!((widths[1] / widths[0] - 1.0).abs() < 0.06, "{widths:?}");
}

/// Nothing is seen for twenty frames: the track coasts, is lost, and is found again with the same id.
#[tokio::test]
async fn a_hidden_object_is_found_again() {
    let server = Server::start(&[]);
    let view = film().swap_remove(0);
    let mut stream = Stream::open(&server, tracking()).await;
    let (seen, hidden) = (request(image_of(&view), &view), request(grey(), &view));
    let frames = [(6, &seen), (20, &hidden), (2, &seen)];
    let mut states: Vec<(u64, TrackState)> = Vec::new();
    for (frame, request) in frames.into_iter().flat_map(|(count, of)| std::iter::repeat_n(of, count)).enumerate() {
        let tracks = stream.tracks(request.clone(), frame as f64 / 30.0).await;
        let track = of(&tracks, "cube");
        states.push((track.track_id, track.state()));
    }
    let expected = [(2, TrackState::New), (4, TrackState::Tracked), (15, TrackState::Coasting), (5, TrackState::Lost)];
    let expected = expected.into_iter().chain([(2, TrackState::Tracked)]);
    let expected: Vec<_> =
        expected.flat_map(|(count, state)| std::iter::repeat_n((states[0].0, state), count)).collect();
    assert_eq!(states, expected);
}

#[tokio::test]
async fn frames_that_do_not_fit_the_stream_are_refused_and_the_next_good_one_is_not() {
    let server = Server::start(&[]);
    let view = film().swap_remove(0);
    let good = request(image_of(&view), &view);
    let mut stream = Stream::open(&server, tracking()).await;
    let id = of(&stream.tracks(good.clone(), 10.0).await, "cube").track_id;
    for (time, words) in [
        (Some(10.0), "'capture_time' is 10, which is not after that of the frame before it, 10"),
        (Some(9.5), "'capture_time' is 9.5, which is not after"),
        (Some(f64::NAN), "must be a finite number"),
        (Some(f64::INFINITY), "must be a finite number"),
        (None, "'capture_time' is in some frames of the stream and not in others"),
    ] {
        let said = stream.refused(good.clone(), time).await;
        assert!(said.contains(words), "{said}");
    }
    let mut bent = good.clone();
    bent.world_from_camera.as_mut().unwrap().rotation_w += 0.5;
    let mut far = good.clone();
    far.world_from_camera.as_mut().unwrap().translation_x_m = f64::NAN;
    let mut millimetres = good.clone();
    let moved = millimetres.world_from_camera.as_mut().unwrap();
    for metres in [&mut moved.translation_x_m, &mut moved.translation_y_m, &mut moved.translation_z_m] {
        *metres *= 1000.0;
    }
    let nowhere = EstimateRequest { world_from_camera: None, ..good.clone() };
    let broken = EstimateRequest { image: b"no image".to_vec().into(), ..good.clone() };
    for (request, words) in [
        (bent, "'world_from_camera' is not a pose"),
        (far, "'world_from_camera' is not a pose"),
        (millimetres, "seem to be in millimetres; give metres"),
        (nowhere, "'world_from_camera' is in some frames"),
        (broken, "image"),
    ] {
        let said = stream.refused(request, Some(10.1)).await;
        assert!(said.contains(words), "{said}");
    }
    // Where the world is known, another camera may look.
    let longer = Camera { fx: 301.0, ..camera() };
    let other = EstimateRequest { camera: Some(CameraChoice::InlineCamera(longer)), ..good.clone() };
    let tracks = stream.tracks(other, 10.1).await;
    assert_eq!((of(&tracks, "cube").track_id, of(&tracks, "cube").state()), (id, TrackState::New));
}

#[tokio::test]
async fn without_a_world_the_camera_stays() {
    let server = Server::start(&[]);
    let view = film().swap_remove(0);
    let good = EstimateRequest { world_from_camera: None, ..request(image_of(&view), &view) };
    let mut stream = Stream::open(&server, tracking()).await;
    let response = stream.send(good.clone(), None).await;
    let tracks = response.tracking.unwrap().tracks;
    assert!(of(&tracks, "cube").world_from_object.is_none());
    let longer = Camera { fx: 400.0, ..camera() };
    let other = EstimateRequest { camera: Some(CameraChoice::InlineCamera(longer)), ..good.clone() };
    let said = stream.refused(other, None).await;
    assert!(said.contains("the camera is not that of the stream's first frame"), "{said}");
    assert!(stream.refused(good.clone(), Some(1.0)).await.contains("in some frames"));
    let response = stream.send(good, None).await;
    assert_eq!(of(&response.tracking.unwrap().tracks, "cube").track_id, of(&tracks, "cube").track_id);
}

async fn status_of(server: &Server, settings: StreamSettings) -> Status {
    Stream::open(server, settings).await.responses.message().await.unwrap_err()
}

#[tokio::test]
async fn settings_that_mean_nothing_are_refused() {
    let server = Server::start(&[]);
    let with =
        |tracking: TrackSettings| StreamSettings { tracking: Some(tracking), track: true, ..StreamSettings::default() };
    let settings = TrackSettings::default();
    for (settings, words) in [
        (StreamSettings { track: false, ..with(settings) }, "'track' is not"),
        (with(TrackSettings { detect_every: 1001, ..settings }), "'detect_every' is 1001"),
        (with(TrackSettings { max_coast_s: f64::NAN, ..settings }), "'max_coast_s' is NaN"),
        (with(TrackSettings { velocity_change_m_s: -1.0, ..settings }), "'velocity_change_m_s' is -1"),
        (with(TrackSettings { forget_s: 1e9, ..settings }), "'forget_s' is 1000000000"),
    ] {
        let status = status_of(&server, settings).await;
        assert_eq!(status.code(), Code::InvalidArgument);
        assert!(status.message().contains(words), "{}", status.message());
    }
    let view = film().swap_remove(0);
    let mut stream = Stream::open(&server, StreamSettings::default()).await;
    let said = stream.refused(request(image_of(&view), &view), Some(1.0)).await;
    assert!(said.contains("'track' in its settings"), "{said}");
}

/// A change of objects between two frames: what has not changed is followed on, what has is another object from then on.
#[tokio::test]
async fn a_stream_goes_on_through_a_change_of_objects() {
    let models = crate::support::copy_of("models");
    let server = Server::start(&["--models", models.path().to_str().unwrap(), "--object-changes"]);
    let mut stream = Stream::open(&server, tracking()).await;
    let film = film();
    let mut ids = Vec::new();
    for (number, view) in film.iter().enumerate() {
        if number == film.len() / 2 {
            let bundle = crate::bundle::Bundle::of("motor").tar();
            assert!(crate::objects::put(&server, "motor", bundle).await.status().is_success());
        }
        let time = f64::from(u8::try_from(number).unwrap()) / 10.0;
        let tracks = stream.tracks(request(image_of(view), view), time).await;
        ids.push(["cube", "motor"].map(|object| of(&tracks, object).track_id));
    }
    let (first, last) = (ids[0], ids[film.len() - 1]);
    assert_eq!(first[0], last[0], "{ids:?}");
    assert_ne!(first[1], last[1], "{ids:?}");
    assert!(ids.windows(2).filter(|pair| pair[0][1] != pair[1][1]).count() == 1, "{ids:?}");
}
