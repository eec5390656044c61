//! Several images of one scene, answered together.

use posed::proto;
use posed::proto::pose_service_client::PoseServiceClient;
use posed_core::geometry::Pose;
use reqwest::header::ACCEPT;
use reqwest::multipart::{Form, Part};
use reqwest::{Client, Response, StatusCode};
use serde_json::{Value, json as value};
use tonic::Code;

use crate::support::{Server, assert_scene_right, assert_still_works, error, json, metrics, png, scene, scene_cameras};

/// Several images in a debug build on a busy machine.
const PATIENT: [&str; 2] = ["--timeout-ms", "60000"];

fn form(images: &[Vec<u8>], request: &Value) -> Form {
    let image = |bytes: &Vec<u8>| Part::bytes(bytes.clone()).file_name("image.jpg");
    let images = images.iter().fold(Form::new(), |form, bytes| form.part("image", image(bytes)));
    images.text("request", request.to_string())
}

async fn send(server: &Server, images: &[Vec<u8>], request: &Value) -> Response {
    Client::new().post(server.url("/v1/poses/views")).multipart(form(images, request)).send().await.unwrap()
}

/// Views with these camera poses.
fn views(poses: &[Value]) -> Value {
    let view = |pose: &Value| value!({"camera": "demo", "world_from_camera": pose});
    value!({"views": poses.iter().map(view).collect::<Vec<_>>()})
}

async fn answer(server: &Server, images: &[Vec<u8>], request: &Value) -> Value {
    let response = send(server, images, request).await;
    let status = response.status();
    let answer = json(response).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    answer
}

#[tokio::test]
async fn three_views_give_one_pose_of_each_object() {
    let server = Server::start(&PATIENT);
    let (images, _) = scene();
    let by_rig = answer(&server, &images, &value!({"rig": "scene", "captured_at": "now"})).await;
    assert_scene_right(&by_rig, 0.06);
    assert_eq!(by_rig["captured_at"], "now");
    assert_eq!(by_rig["views"].as_array().unwrap().len(), 3);
    for object in by_rig["objects"].as_array().unwrap().iter().filter(|object| object["status"] != "rejected") {
        let used = object["views"].as_array().unwrap().iter().filter(|view| view["used"] == true).count();
        assert!(used >= 2, "{object}");
        // What the camera sees is where the world has it.
        let share = &object["views"][0];
        let place = share["pose"].as_u64().unwrap();
        let own = &by_rig["views"][usize::try_from(share["view"].as_u64().unwrap()).unwrap()]["poses"]
            [usize::try_from(place).unwrap()];
        assert_eq!(own["object"], object["object"]);
        let z = |pose: &Value| pose["camera_from_object"]["translation_m"][2].as_f64().unwrap();
        assert!((z(share) - z(own)).abs() < 0.05);
        assert!(object["view_angle_deg"].as_f64().unwrap() > 30.0);
        assert!(object["scale"]["sigma"].as_f64().is_none_or(|sigma| sigma > 0.0 && sigma < 0.1));
    }
    // The same cameras, sent along.
    let by_views = answer(&server, &images, &views(&scene_cameras())).await;
    assert_eq!(by_rig["objects"], by_views["objects"]);
    // The rig elsewhere: the poses go along.
    let world_from_rig = value!({"rotation_xyzw": [0, 0, 0, 1], "translation_m": [1.0, 2.0, 3.0]});
    let moved = answer(&server, &images, &value!({"rig": "scene", "world_from_rig": world_from_rig})).await;
    let x = |answer: &Value| answer["objects"][0]["world_from_object"]["translation_m"][0].as_f64().unwrap();
    assert!((x(&moved) - x(&by_rig) - 1.0).abs() < 1e-6);
    // Only what was asked for.
    let cube = answer(&server, &images, &value!({"rig": "scene", "objects": ["cube"]})).await;
    assert!(cube["objects"].as_array().unwrap().iter().all(|object| object["object"] == "cube"));
    assert!(metrics(&server).await.contains("/v1/poses/views"));
}

/// The depth that one view has to guess is where several views help.
#[tokio::test]
async fn covariances_shrink_with_views() {
    let server = Server::start(&PATIENT);
    let (images, _) = scene();
    let answer = answer(&server, &images, &value!({"rig": "scene"})).await;
    let trace = |covariance: &Value| (0..3).map(|axis| covariance[axis][axis].as_f64().unwrap()).sum::<f64>();
    for object in answer["objects"].as_array().unwrap().iter().filter(|object| object["status"] != "rejected") {
        let fused = trace(&object["world_from_object"]["covariance"]);
        let alone = |view: &Value| {
            let index = |field: &str| usize::try_from(view[field].as_u64().unwrap()).unwrap();
            trace(&answer["views"][index("view")]["poses"][index("pose")]["covariance"])
        };
        let least = object["views"].as_array().unwrap().iter().map(alone).fold(f64::INFINITY, f64::min);
        // A view's own covariance is taken for too small, so that two of them need not be better than it says.
        assert!(fused < 1.5 * least, "{} {fused} {least}", object["object"]);
    }
}

/// A camera that stands elsewhere than it is said to is found out, and does no harm.
#[tokio::test]
async fn a_wrong_view_is_named() {
    let server = Server::start(&PATIENT);
    let (images, known) = scene();
    let mut poses = scene_cameras();
    // The first image again, as if from where the second camera stands.
    poses.push(poses[1].clone());
    let images = [&images[..], &images[..1]].concat();
    let answer = answer(&server, &images, &views(&poses)).await;
    let cubes: Vec<_> =
        answer["objects"].as_array().unwrap().iter().filter(|object| object["world_from_object"].is_object()).collect();
    for known in &known {
        let best = cubes.iter().find(|object| object["object"] == known.object.as_str()).unwrap();
        let transform = &best["world_from_object"];
        let error = known.error(
            serde_json::from_value(transform["rotation_xyzw"].clone()).unwrap(),
            serde_json::from_value(transform["translation_m"].clone()).unwrap(),
        );
        assert!(error < 0.06, "{}: {error}", known.object);
        let fourth = best["views"].as_array().unwrap().iter().find(|view| view["view"] == 3);
        // Where it is not even near the object, it is an object of its own.
        assert!(fourth.is_none_or(|view| view["used"] == false && view["left_out"] == "contradicts"), "{best}");
        if fourth.is_some() {
            assert!(best["reasons"].as_array().unwrap().contains(&value!("views_disagree")), "{best}");
        }
    }
}

/// The images, in some of which the motor is painted over.
async fn without_motor(server: &Server, images: &[Vec<u8>], hidden: &[usize]) -> Vec<Vec<u8>> {
    let found = answer(server, images, &value!({"rig": "scene"})).await;
    let mut images = images.to_vec();
    for view in hidden {
        let poses = found["views"][view]["poses"].as_array().unwrap();
        let mut image = image::load_from_memory(&images[*view]).unwrap().to_rgb8();
        for pose in poses.iter().filter(|pose| pose["object"] == "motor") {
            let [x, y, w, h]: [f64; 4] = serde_json::from_value(pose["detection"]["box_px"].clone()).unwrap();
            let inside = |at: u32, from: f64, side: f64| (from - 4.0..from + side + 4.0).contains(&f64::from(at));
            for (column, row, pixel) in image.enumerate_pixels_mut() {
                if inside(column, x, w) && inside(row, y, h) {
                    *pixel = image::Rgb([120, 110, 100]);
                }
            }
        }
        images[*view] = png(&image.into());
    }
    images
}

/// Views that see each object elsewhere cannot all be right: whom nobody bears out is not `ok`, wherever the cameras were said
/// to stand.
#[tokio::test]
async fn cameras_far_from_where_they_stood_make_nothing_ok() {
    let server = Server::start(&PATIENT);
    let (images, known) = scene();
    let ok = |answer: &Value| -> Vec<Value> {
        answer["objects"].as_array().unwrap().iter().filter(|object| object["status"] == "ok").cloned().collect()
    };
    // One of three: the others outnumber it.
    let mut poses = scene_cameras();
    let x = poses[1]["translation_m"][0].as_f64().unwrap();
    poses[1]["translation_m"][0] = (x + 0.3).into();
    let outnumbered = answer(&server, &images, &views(&poses)).await;
    assert!(ok(&outnumbered).len() >= 3, "{outnumbered}");
    for object in ok(&outnumbered) {
        let transform = &object["world_from_object"];
        let known = known.iter().find(|known| object["object"] == known.object.as_str()).unwrap();
        let error = known.error(
            serde_json::from_value(transform["rotation_xyzw"].clone()).unwrap(),
            serde_json::from_value(transform["translation_m"].clone()).unwrap(),
        );
        assert!(error < 0.06, "{object}");
        assert!(object["reasons"].as_array().unwrap().contains(&value!("views_disagree")), "{object}");
    }
    // A camera need not state its size for that.
    let pinhole = value!({"model": "pinhole", "fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5});
    let mut unsized_views = views(&poses);
    for view in unsized_views["views"].as_array_mut().unwrap() {
        view["camera"] = pinhole.clone();
    }
    let unsized_answer = answer(&server, &images, &unsized_views).await;
    assert_eq!(ok(&unsized_answer).len(), ok(&outnumbered).len(), "{unsized_answer}");
    assert!(ok(&unsized_answer).iter().all(|object| object["views"].as_array().unwrap().len() > 1));
    // What it alone shows is as wrong as it is.
    let alone = answer(&server, &without_motor(&server, &images, &[0, 2]).await, &views(&poses)).await;
    let motor: Vec<_> = alone["objects"].as_array().unwrap().iter().filter(|one| one["object"] == "motor").collect();
    assert!(motor.iter().any(|one| one["reasons"].as_array().unwrap().contains(&value!("single_view"))), "{alone}");
    assert!(motor.iter().all(|one| one["status"] != "ok"), "{alone}");
    // Two that were exchanged, and quaternions in another order: nobody knows which is right.
    let exchanged = vec![scene_cameras()[1].clone(), scene_cameras()[0].clone()];
    let wxyz = |pose: &Value| {
        let mut pose = pose.clone();
        pose["rotation_xyzw"].as_array_mut().unwrap().rotate_right(1);
        pose
    };
    for wrong in [exchanged, scene_cameras()[..2].iter().map(wxyz).collect()] {
        let answer = answer(&server, &images[..2], &views(&wrong)).await;
        assert_eq!(ok(&answer), Vec::<Value>::new());
        let said = answer["objects"].as_array().unwrap().iter();
        let said = said.filter(|object| object["reasons"].as_array().unwrap().contains(&value!("views_disagree")));
        assert!(said.count() >= 4, "{answer}");
    }
}

/// No baseline, no fusion: said, and answered as one view has it.
#[tokio::test]
async fn cameras_in_one_place_are_answered_as_single_views() {
    let server = Server::start(&PATIENT);
    let (images, _) = scene();
    let pose = &scene_cameras()[0];
    let images = vec![images[0].clone(); 2];
    let answer = answer(&server, &images, &views(&[pose.clone(), pose.clone()])).await;
    let objects = answer["objects"].as_array().unwrap();
    assert!(!objects.is_empty());
    for object in objects.iter().filter(|object| object["views"].as_array().unwrap().len() == 2) {
        let reasons = object["reasons"].as_array().unwrap();
        assert!(reasons.contains(&value!("weak_baseline")) && reasons.contains(&value!("single_view")), "{object}");
        let used: Vec<_> = object["views"].as_array().unwrap().iter().filter(|view| view["used"] == true).collect();
        assert_eq!(used.len(), 1);
        assert!(object["views"].as_array().unwrap().iter().any(|view| view["left_out"] == "no_baseline"));
    }
}

#[tokio::test]
async fn the_answer_can_be_a_picture_of_all_views() {
    let server = Server::start(&PATIENT);
    let (images, _) = scene();
    let form = form(&images, &value!({"rig": "scene"}));
    let request = Client::new().post(server.url("/v1/poses/views")).header(ACCEPT, "image/png").multipart(form);
    let response = request.send().await.unwrap();
    assert_eq!(response.headers()["content-type"], "image/png");
    let picture = image::load_from_memory(&response.bytes().await.unwrap()).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (3 * 640, 480));
    for (view, plain) in images.iter().enumerate() {
        let plain = image::load_from_memory(plain).unwrap().into_rgb8();
        let left = 640 * u32::try_from(view).unwrap();
        let changed =
            plain.enumerate_pixels().filter(|(x, y, pixel)| picture.get_pixel(left + x, *y) != *pixel).count();
        assert!((200..60_000).contains(&changed), "{changed} pixels drawn into view {view}");
    }
    assert_still_works(&server).await;
}

#[tokio::test]
async fn bad_requests_say_what_is_wrong() {
    let server = Server::start(&[&PATIENT[..], &["--max-views", "4"]].concat());
    let (images, _) = scene();
    let poses = scene_cameras();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut request = views(&poses);
        change(&mut request["views"][1]);
        request
    };
    let stretched = changed(&|view| view["world_from_camera"]["rotation_xyzw"] = value!([1, 1, 1, 1]));
    let millimetres = changed(&|view| {
        let metres: [f64; 3] = serde_json::from_value(view["world_from_camera"]["translation_m"].clone()).unwrap();
        view["world_from_camera"]["translation_m"] = value!(metres.map(|metres| 1e3 * metres));
    });
    let lopsided = changed(&|view| {
        view["covariance"] = value!([
            [0, 1, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0]
        ]);
    });
    let unknown = changed(&|view| view["camera"] = value!("nowhere"));
    let small = png(&image::DynamicImage::new_rgb8(320, 240));
    let with_small = [images[0].clone(), images[1].clone(), small];
    let many = vec![images[0].clone(); 5];
    let all = &images[..];
    for (images, request, status, code, words) in [
        (&images[..1], views(&poses[..1]), 400, "invalid_request", "2 to 4 ('max_views')"),
        (&many[..], views(&poses), 413, "too_large", "'max_views'"),
        (&images[..2], views(&poses), 400, "invalid_request", "2 images for 3 cameras"),
        (all, stretched, 400, "invalid_request", "'views[1].world_from_camera' is not a pose: quaternion"),
        (all, millimetres, 400, "invalid_request", "seems to be in millimetres"),
        (all, lopsided, 400, "invalid_request", "view 1: field 'covariance'"),
        (all, unknown, 404, "unknown_camera", "view 1: unknown camera \"nowhere\""),
        (&with_small[..], views(&poses), 400, "invalid_request", "view 2: "),
        (all, value!({"rig": "nowhere"}), 404, "unknown_camera", "known rigs: scene"),
        (all, value!({"rig": "scene", "views": []}), 400, "invalid_request", "not both"),
        (all, value!({"rig": "scene", "colour": 1}), 400, "invalid_request", "colour"),
        (all, value!({}), 400, "invalid_request", "'views'"),
        (all, value!({"rig": "scene", "objects": ["unicorn"]}), 404, "unknown_object", "unicorn"),
    ] {
        let response = send(&server, images, &request).await;
        assert_eq!(response.status().as_u16(), status, "{request}");
        let (found, message) = error(response).await;
        assert!(found == code && message.contains(words), "{words}: {found} {message}");
    }
    let damaged = [all[0].clone(), all[1].clone(), b"no image".to_vec()];
    let (_, message) = error(send(&server, &damaged, &views(&poses)).await).await;
    assert!(message.starts_with("view 2: "), "{message}");
    assert_scene_right(&answer(&server, all, &views(&poses)).await, 0.06);
}

/// Poses that are right but for what people get wrong about poses: the error says what.
#[tokio::test]
async fn poses_of_cameras_that_cannot_be_meant_are_guessed() {
    let server = Server::start(&PATIENT);
    let (images, _) = scene();
    let half_turn = Pose::from_quaternion_xyzw([1.0, 0.0, 0.0, 0.0], [0.0; 3]).unwrap();
    let changed = |change: &dyn Fn(&Pose) -> Pose| {
        let pose = |known: &Value| {
            let numbers = |field: &str| known[field].clone();
            let rotation = serde_json::from_value(numbers("rotation_xyzw")).unwrap();
            let translation = serde_json::from_value(numbers("translation_m")).unwrap();
            let pose = change(&Pose::from_quaternion_xyzw(rotation, translation).unwrap());
            value!({"rotation_xyzw": pose.rotation_xyzw(), "translation_m": pose.translation_m()})
        };
        views(&scene_cameras().iter().map(pose).collect::<Vec<_>>())
    };
    for (request, words) in [
        (changed(&Pose::inverse), "camera_from_world; give their inverses"),
        (changed(&|pose| *pose * half_turn), "as in OpenGL"),
    ] {
        let response = send(&server, &images, &request).await;
        assert_eq!(response.status(), StatusCode::BAD_REQUEST, "{words}");
        let (code, message) = error(response).await;
        assert!(code == "invalid_request" && message.contains(words), "{message}");
    }
    assert_scene_right(&answer(&server, &images, &views(&scene_cameras())).await, 0.06);
}

#[tokio::test]
async fn grpc_says_the_same() {
    let server = Server::start(&PATIENT);
    let (images, _) = scene();
    let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let view = |bytes: &Vec<u8>| proto::View { image: bytes.clone().into(), ..proto::View::default() };
    let by_rig = proto::EstimateViewsRequest {
        rig_id: "scene".into(),
        views: images.iter().map(view).collect(),
        ..proto::EstimateViewsRequest::default()
    };
    let found = client.estimate_views(by_rig.clone()).await.unwrap().into_inner();
    let expected = answer(&server, &images, &value!({"rig": "scene"})).await;
    assert_eq!(found.objects.len(), expected["objects"].as_array().unwrap().len());
    assert_eq!(found.views.len(), 3);
    for (found, expected) in found.objects.iter().zip(expected["objects"].as_array().unwrap()) {
        assert_eq!(found.object, expected["object"].as_str().unwrap());
        let placed = found.world_from_object.as_ref().unwrap();
        let x = expected["world_from_object"]["translation_m"][0].as_f64().unwrap();
        assert!((placed.transform.unwrap().translation_x_m - x).abs() < 1e-9);
        assert_eq!((placed.covariance.len(), found.views.len()), (36, expected["views"].as_array().unwrap().len()));
    }
    let mut mixed = by_rig.clone();
    mixed.views[1].camera = Some(proto::view::Camera::CameraId("demo".into()));
    let mut one = by_rig.clone();
    one.views.truncate(1);
    let mut no_pose = by_rig.clone();
    no_pose.rig_id.clear();
    for (request, words) in
        [(mixed, "a camera of its own"), (one, "'max_views'"), (no_pose, "'views[0]' has no camera")]
    {
        let status = client.estimate_views(request).await.unwrap_err();
        assert!(status.code() == Code::InvalidArgument && status.message().contains(words), "{status}");
    }
    assert_eq!(client.estimate_views(by_rig).await.unwrap().into_inner().objects.len(), found.objects.len());
}
