//! `PUT /v1/objects/{name}/reference`.

use std::fs::File;
use std::time::{Duration, SystemTime};

use nalgebra::Vector3;
use posed_core::geometry::{Camera, Pose};
use reqwest::multipart::{Form, Part};
use reqwest::{Client, Response, StatusCode};
use serde_json::{Value, json as value};

use crate::clicked::ClickedCube;
use crate::support::{
    CAMERA, Server, change, copy_of, error, json, png, post, read, refuses_to_serve, samples, scene, scene_poses,
    two_cubes,
};

pub(crate) async fn put(server: &Server, object: &str, images: &[Vec<u8>], request: &Value) -> Response {
    let image = |bytes: &Vec<u8>| Part::bytes(bytes.clone()).file_name("image");
    let form = images.iter().fold(Form::new(), |form, bytes| form.part("image", image(bytes)));
    let form = form.text("request", request.to_string());
    Client::new().put(server.url(&format!("/v1/objects/{object}/reference"))).multipart(form).send().await.unwrap()
}

async fn cube(server: &Server) -> Value {
    pose_of(&json(post(server, CAMERA, read(&samples()[0].file)).await).await, "cube")
}

/// The best of an object's poses.
fn pose_of(answer: &Value, object: &str) -> Value {
    answer["poses"].as_array().unwrap().iter().find(|pose| pose["object"] == object).unwrap().clone()
}

/// An answered pose as a request states it.
pub(crate) fn stated(answer: &Value) -> Value {
    let pose = &answer["camera_from_object"];
    value!({"rotation_xyzw": pose["rotation_xyzw"], "translation_m": pose["translation_m"]})
}

/// A new frame of the object, half a metre to the side, holds from the next image on, and after a restart.
#[tokio::test]
async fn a_new_reference_takes_effect_at_once_and_stays() {
    let folder = copy_of("reference");
    let arguments = ["--reference", folder.path().to_str().unwrap(), "--recalibration"];
    let server = Server::start(&arguments);
    let before = cube(&server).await;
    let mut pose = stated(&before);
    let x = pose["translation_m"][0].as_f64().unwrap();
    pose["translation_m"][0] = (x + 0.5).into();
    // Without a box: the detector's.
    let mut request = value!({"references": [{"camera": "demo", "camera_from_object": pose}]});
    let refusal = put(&server, "cube", &[read(&samples()[0].file)], &request).await;
    assert_eq!(refusal.status(), StatusCode::UNPROCESSABLE_ENTITY);
    assert!(error(refusal).await.1.contains("'far_origin'"));
    request["far_origin"] = true.into();
    let response = put(&server, "cube", &[read(&samples()[0].file)], &request).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert_eq!(json(response).await["method"], "single");
    let moved = |pose: &Value| pose["camera_from_object"]["translation_m"][0].as_f64().unwrap() - x;
    assert!((moved(&cube(&server).await) - 0.5).abs() < 1e-3);
    drop(server);
    let restarted = Server::start(&arguments);
    assert!((moved(&cube(&restarted).await) - 0.5).abs() < 1e-3);
}

/// A program that was killed while it wrote leaves files, which the next one removes; young ones may be another replica's.
#[tokio::test]
async fn what_was_left_over_is_removed() {
    let folder = copy_of("reference");
    let long_ago = SystemTime::now() - Duration::from_hours(2);
    let names = [".tmpAbCdEf", "cube-0123456789ab.jpg", "notes.txt", "cube-left.jpg", "cube.jpg"];
    for name in names {
        let file = File::options().create(true).append(true).open(folder.path().join(name)).unwrap();
        file.set_modified(long_ago).unwrap();
    }
    std::fs::write(folder.path().join("cube-ba9876543210.jpg"), b"young").unwrap();
    let _server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let there = |name: &&str| folder.path().join(name).exists();
    assert_eq!(names.into_iter().filter(there).collect::<Vec<_>>(), names[2..]);
    assert!(there(&"cube-ba9876543210.jpg"));
}

/// What was fitted of how large the network sees the object is not lost, and the new offset is that of keypoints of this scale.
#[tokio::test]
async fn a_fitted_scale_stays() {
    let folder = copy_of("reference");
    let file = folder.path().join("cube.json");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let mut pose = stated(&cube(&server).await);
    for metres in pose["translation_m"].as_array_mut().unwrap() {
        *metres = (1.04 * metres.as_f64().unwrap()).into();
    }
    // By another process, of which the server does not know yet.
    change(&file, |json| json["keypoints_scale"] = 1.04.into());
    let request = value!({"references": [{"camera": "demo", "camera_from_object": pose}]});
    let response = put(&server, "cube", &[read(&samples()[0].file)], &request).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert_eq!(json(response).await["keypoints_scale"], 1.04);
    let written: Value = serde_json::from_slice(&read(&file)).unwrap();
    assert_eq!(written["keypoints_scale"], 1.04);
    let again = cube(&server).await;
    assert_eq!(again["keypoints_scale"], 1.04);
    let depth = |pose: &Value| pose["translation_m"][2].as_f64().unwrap();
    let (stated, found) = (depth(&pose), depth(&again["camera_from_object"]));
    assert!((found / stated - 1.0).abs() < 5e-3, "{stated} {found}");
}

/// The bundled scene as references of one object, whose distances are stated so many times as long.
fn references(object: &str, farther: f64) -> Vec<Value> {
    scene_poses(object).iter().map(|seen| known_view(&seen.scaled(farther))).collect()
}

fn known_view(camera_from_object: &Pose) -> Value {
    let pose = value!({
        "rotation_xyzw": camera_from_object.rotation_xyzw(), "translation_m": camera_from_object.translation_m()
    });
    value!({"camera": "demo", "camera_from_object": pose})
}

/// Cameras that stand farther off than they say show what seems to be a larger object: told in the answer, in force on demand.
#[tokio::test]
async fn the_scale_is_fitted_on_demand() {
    const FARTHER: f64 = 1.03;
    let folder = copy_of("reference");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let (images, _) = scene();
    let known = references("cube", FARTHER);
    let told = json(put(&server, "cube", &images, &value!({ "references": known })).await).await;
    let fitted = told["fitted_scale"]["value"].as_f64().unwrap();
    assert!((fitted - FARTHER).abs() < 0.015 && told["keypoints_scale"] == 1.0, "{told}");
    let two = value!({"references": known[..2], "fit_scale": true});
    let refused = put(&server, "cube", &images[..2], &two).await;
    assert_eq!(refused.status(), StatusCode::UNPROCESSABLE_ENTITY);
    let said = error(refused).await.1;
    assert!(said.contains("at least three") && said.contains("of these 2"), "{said}");
    let request = value!({"references": known, "fit_scale": true});
    let stored = json(put(&server, "cube", &images, &request).await).await;
    assert_eq!(stored["keypoints_scale"], stored["fitted_scale"]["value"]);
    let answer = json(post(&server, CAMERA, images[0].clone()).await).await;
    let depth = |pose: &Value| pose["camera_from_object"]["translation_m"][2].as_f64().unwrap();
    let ratio = depth(&pose_of(&answer, "cube")) / depth(&known[0]);
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}

/// A reference that the offset does not rest on says nothing of the scale either.
#[tokio::test]
async fn a_wrong_reference_does_not_change_the_scale() {
    let folder = copy_of("reference");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let (mut images, _) = scene();
    let mut known = references("cube", 1.0);
    let fitted = async |images: &[Vec<u8>], known: &[Value]| {
        let request = value!({"references": known, "fit_scale": true});
        json(put(&server, "cube", images, &request).await).await
    };
    let right = fitted(&images, &known).await;
    let sample = samples().swap_remove(0);
    let seen = sample.objects.iter().find(|known| known.object == "cube").unwrap().pose();
    images.push(read(&sample.file));
    let too_deep = Pose::new(*seen.rotation(), seen.translation() * (1.0 + 0.045 / seen.translation().norm()));
    known.push(known_view(&too_deep));
    let with_wrong = fitted(&images, &known).await;
    assert_eq!(with_wrong["views"][3]["inlier"], false, "{with_wrong}");
    let scale = |answer: &Value| answer["keypoints_scale"].as_f64().unwrap();
    assert!((scale(&right) - scale(&with_wrong)).abs() < 1e-9, "{right} {with_wrong}");
}

#[tokio::test]
async fn what_cannot_be_measured_changes_nothing() {
    let folder = copy_of("reference");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let before = cube(&server).await;
    let pose = value!({"rotation_xyzw": [0, 0, 0, 1], "translation_m": [0, 0, 1]});
    let known = |extra: &Value| {
        let mut known = value!({"camera": "demo", "camera_from_object": pose});
        known.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        value!({"references": [known]})
    };
    let image = read(&samples()[0].file);
    let grey = png(&image::load_from_memory(&image).unwrap().to_luma8().into());
    let twice = value!({"references": [{"camera": "demo", "camera_from_object": pose}, {"camera": "demo", "camera_from_object": pose}]});
    let cases = [
        ("teapot", vec![image.clone()], known(&value!({})), StatusCode::NOT_FOUND, "known objects"),
        (
            "cube",
            vec![image.clone(), image.clone()],
            known(&value!({})),
            StatusCode::BAD_REQUEST,
            "2 parts 'image' for 1",
        ),
        // It would count as two measurements.
        (
            "cube",
            vec![image.clone(); 2],
            twice,
            StatusCode::UNPROCESSABLE_ENTITY,
            "image 0 and image 1 have the same pose",
        ),
        ("cube", vec![image.clone()], known(&value!({"colour": 1})), StatusCode::BAD_REQUEST, "colour"),
        ("cube", vec![image.clone()], known(&value!({"camera": "left"})), StatusCode::NOT_FOUND, "left"),
        (
            "cube",
            vec![image.clone()],
            known(&value!({"box_px": [700, 100, 40, 40]})),
            StatusCode::UNPROCESSABLE_ENTITY,
            "outside the image",
        ),
        // An empty corner of the picture.
        (
            "cube",
            vec![image.clone()],
            known(&value!({"box_px": [5, 5, 40, 40]})),
            StatusCode::UNPROCESSABLE_ENTITY,
            "larger and unoccluded",
        ),
        // What rests on it would inherit its faults.
        ("cube", vec![grey], known(&value!({})), StatusCode::UNPROCESSABLE_ENTITY, "(grey_image)"),
        ("cube", vec![two_cubes()], known(&value!({})), StatusCode::UNPROCESSABLE_ENTITY, "more than once"),
    ];
    for (object, images, request, status, words) in cases {
        let response = put(&server, object, &images, &request).await;
        let found = response.status();
        let (_, message) = error(response).await;
        assert!(found == status && message.contains(words), "{object} {request}: {found} {message}");
    }
    assert_eq!(cube(&server).await, before);
}

/// Two servers on one folder: what one is given, the other takes up, and both say which reference is in force. Images of
/// earlier references are not left behind.
#[tokio::test]
async fn a_new_reference_reaches_every_server_on_the_folder() {
    let folder = copy_of("reference");
    let arguments = ["--reference", folder.path().to_str().unwrap(), "--recalibration"];
    let (first, second) = (Server::start(&arguments), Server::start(&arguments));
    let before = cube(&first).await;
    let request = value!({"references": [{"camera": "demo", "camera_from_object": stated(&before)}]});
    let in_force = json(put(&first, "cube", &[read(&samples()[0].file)], &request).await).await;
    let hash = |server: &Server| {
        let url = server.url("/v1/objects/cube");
        async { json(reqwest::get(url).await.unwrap()).await["reference"]["sha256"].clone() }
    };
    assert_eq!(hash(&first).await, in_force["sha256"]);
    let patience = tokio::time::Instant::now() + std::time::Duration::from_secs(30);
    while hash(&second).await != in_force["sha256"] {
        assert!(tokio::time::Instant::now() < patience, "the other server keeps its old reference");
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
    let files =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let of_cube: Vec<String> = files.filter(|file| file.starts_with("cube")).collect();
    assert_eq!(of_cube.len(), 2, "{of_cube:?}");
    // A file that is no reference changes nothing.
    std::fs::write(folder.path().join("cube.json"), "{").unwrap();
    tokio::time::sleep(std::time::Duration::from_secs(5)).await;
    assert_eq!(hash(&second).await, in_force["sha256"]);
    cube(&second).await;
}

/// What could not be written at the first request is known at the start.
#[test]
fn a_folder_that_cannot_be_written_is_refused_at_the_start() {
    refuses_to_serve(&["--recalibration", "--reference", "Cargo.toml"], "Cargo.toml");
}

#[tokio::test]
async fn it_is_off_unless_allowed() {
    let server = Server::start(&[]);
    let response = put(&server, "cube", &[read(&samples()[0].file)], &value!({"references": []})).await;
    assert_eq!(response.status(), StatusCode::FORBIDDEN);
    assert!(error(response).await.1.contains("--recalibration"));
}

/// Points clicked in two images stand for a known pose, and the image of the reference can be seen.
#[tokio::test]
async fn clicks_in_two_images_are_a_reference() {
    let folder = copy_of("reference");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let (before, image) = (cube(&server).await, read(&samples()[0].file));
    // What a second camera, 30 cm to the side, sees of corners of the object's frame.
    let pose = stated(&before);
    let numbers = |field: &str| pose[field].clone();
    let rotation = serde_json::from_value(numbers("rotation_xyzw")).unwrap();
    let pose = Pose::from_quaternion_xyzw(rotation, serde_json::from_value(numbers("translation_m")).unwrap()).unwrap();
    let second_from_first = Pose::from_quaternion_xyzw([0.0, 0.0, 0.0, 1.0], [0.3, 0.0, 0.0]).unwrap();
    let camera = Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap();
    let click = |point: [f64; 3]| {
        let in_first = pose.transform(&Vector3::from(point));
        let pixel = |point| camera.project(&point).map(|pixel| [pixel.x, pixel.y]).unwrap();
        value!({"first_px": pixel(in_first), "second_px": pixel(second_from_first.transform(&in_first))})
    };
    let points = [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.03], [0.03, 0.03, 0.01]];
    let clicks = value!({
        "first_camera": "demo", "second_camera": camera, "clicks": points.map(click),
        "second_from_first": {"rotation_xyzw": [0, 0, 0, 1], "translation_m": [0.3, 0, 0]},
        "frame": {"origin": 0, "on_x": 1, "in_xy": 2},
    });
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut clicks = clicks.clone();
        change(&mut clicks);
        value!({"clicks": clicks})
    };
    let unmeasurable = StatusCode::UNPROCESSABLE_ENTITY;
    for (images, request, status, words) in [
        (2, changed(&|_| ()), StatusCode::BAD_REQUEST, "2 parts 'image' for 1 pairs in 'clicks'"),
        (0, value!({"clicks": []}), StatusCode::BAD_REQUEST, "field 'clicks' is empty; give the pairs"),
        (1, value!({"clicks": "all"}), StatusCode::BAD_REQUEST, "a pair of images with clicks, or a list of pairs"),
        (1, value!({}), StatusCode::BAD_REQUEST, "either 'references'"),
        (1, changed(&|all| all["clicks"] = value!([])), StatusCode::BAD_REQUEST, "0 clicked points"),
        (1, changed(&|all| all["frame"]["origin"] = 9.into()), StatusCode::BAD_REQUEST, "refers to click 9"),
        (1, changed(&|all| all["frame"]["in_xy"] = 1.into()), unmeasurable, "of one line"),
        (1, changed(&|all| all["second_camera"] = "left".into()), StatusCode::NOT_FOUND, "left"),
        (1, changed(&|all| all["clicks"][0]["second_px"][1] = 0.into()), unmeasurable, "rays miss each other"),
    ] {
        let response = put(&server, "cube", &vec![image.clone(); images], &request).await;
        let found = response.status();
        let (_, message) = error(response).await;
        assert!(found == status && message.contains(words), "{request}: {found} {message}");
    }
    let response = put(&server, "cube", std::slice::from_ref(&image), &value!({"clicks": clicks})).await;
    assert_eq!(response.status(), StatusCode::OK);
    let view = json(response).await["views"][0].clone();
    let made: Vec<f64> = serde_json::from_value(view["camera_from_object"]["translation_m"].clone()).unwrap();
    assert!((Vector3::from_iterator(made) - pose.translation()).norm() < 1e-6);
    // The frame is the one that it had.
    let [old, new] = [before, cube(&server).await]
        .map(|pose| Vector3::from(serde_json::from_value::<[f64; 3]>(stated(&pose)["translation_m"].clone()).unwrap()));
    assert!((old - new).norm() < 1e-3);

    let get = |name: &str| reqwest::get(server.url(&format!("/v1/objects/cube/reference/{name}")));
    let shown = get(view["image"].as_str().unwrap()).await.unwrap();
    assert_eq!((shown.status(), &shown.headers()["content-type"]), (StatusCode::OK, &"image/jpeg".parse().unwrap()));
    assert_eq!(shown.bytes().await.unwrap(), image);
    for name in ["cube.json", "motor.jpg", "..%2fCargo.toml", "nothing.jpg"] {
        assert_eq!(get(name).await.unwrap().status(), StatusCode::NOT_FOUND, "{name}");
    }
}

/// Several pairs are a reference of several views, each measured by itself.
#[tokio::test]
async fn several_pairs_of_images_are_one_reference() {
    let folder = copy_of("reference");
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let (cube, (images, _)) = (ClickedCube::new(), scene());
    let mut pairs = [cube.pair(0, 1), cube.pair(1, 2)];
    pairs[1]["clicks"][3]["second_px"][1] = 0.into();
    let pairs_of = |pairs: &[Value]| value!({"clicks": pairs});
    let slipped = put(&server, "cube", &images[..2], &pairs_of(&pairs)).await;
    assert_eq!(slipped.status(), StatusCode::UNPROCESSABLE_ENTITY);
    let (_, message) = error(slipped).await;
    assert!(message.starts_with("image 1: field 'clicks': click 3: its two rays miss each other"), "{message}");
    pairs[1] = cube.pair(1, 2);
    pairs[1]["frame"]["on_y"] = 1.into();
    let (_, message) = error(put(&server, "cube", &images[..2], &pairs_of(&pairs)).await).await;
    assert!(message.contains("clicks[1].frame"), "{message}");
    pairs[1] = cube.pair(1, 2);
    let (_, message) = error(put(&server, "cube", &images[..1], &pairs_of(&pairs)).await).await;
    assert!(message.contains("1 parts 'image' for 2 pairs in 'clicks'"), "{message}");
    // In the second image, a box of something else.
    let seen = json(post(&server, CAMERA, images[1].clone()).await).await;
    let box_of = |is_it: &dyn Fn(&Value) -> bool| {
        seen["poses"].as_array().unwrap().iter().find(|pose| is_it(pose)).unwrap()["detection"]["box_px"].clone()
    };
    pairs[1]["box_px"] = box_of(&|pose| pose["object"] != "cube");
    let response = put(&server, "cube", &images[..2], &pairs_of(&pairs)).await;
    assert_eq!(response.status(), StatusCode::UNPROCESSABLE_ENTITY);
    let (_, message) = error(response).await;
    assert!(message.starts_with("image 1: "), "{message}");
    pairs[1]["box_px"] = box_of(&|pose| pose["object"] == "cube" && pose["status"] == "ok");
    let response = put(&server, "cube", &images[..2], &pairs_of(&pairs)).await;
    assert_eq!(response.status(), StatusCode::OK);
    let made = json(response).await;
    assert_eq!((&made["method"], made["views"].as_array().unwrap().len()), (&"weighted".into(), 2));
    cube.assert_right(&made["views"]);
}

/// A reference file that names a file elsewhere gives nothing away.
#[tokio::test]
async fn a_reference_leads_nowhere_else() {
    let folder = copy_of("reference");
    let elsewhere = samples()[0].file.to_str().unwrap().to_owned();
    for name in [elsewhere.as_str(), "../cube.jpg"] {
        change(&folder.path().join("cube.json"), |file| file["references"][0]["image"] = name.into());
        let server = Server::start(&["--reference", folder.path().to_str().unwrap()]);
        let name: String = name.replace('/', "%2f");
        let response = reqwest::get(server.url(&format!("/v1/objects/cube/reference/{name}"))).await.unwrap();
        assert_eq!(response.status(), StatusCode::NOT_FOUND);
    }
}
