//! `PUT /v1/objects/{name}/reference`.

use reqwest::multipart::{Form, Part};
use reqwest::{Client, Response, StatusCode};
use serde_json::{Value, json as value};

use crate::support::{CAMERA, Server, copy_of, error, json, post, read, refuses_to_serve, samples, two_cubes};

async fn put(server: &Server, object: &str, images: &[Vec<u8>], request: &Value) -> Response {
    let image = |bytes: &Vec<u8>| Part::bytes(bytes.clone()).file_name("image");
    let form = images.iter().fold(Form::new(), |form, bytes| form.part("image", image(bytes)));
    let form = form.text("request", request.to_string());
    Client::new().put(server.url(&format!("/v1/objects/{object}/reference"))).multipart(form).send().await.unwrap()
}

async fn cube(server: &Server) -> Value {
    let answer = json(post(server, CAMERA, read(&samples()[0].file)).await).await;
    answer["poses"].as_array().unwrap().iter().find(|pose| pose["object"] == "cube").unwrap().clone()
}

/// An answered pose as a request states it.
fn stated(answer: &Value) -> Value {
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
