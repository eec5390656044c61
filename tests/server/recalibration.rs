//! `PUT /v1/objects/{name}/reference`.

use reqwest::multipart::{Form, Part};
use reqwest::{Client, Response, StatusCode};
use serde_json::{Value, json as value};

use crate::support::{CAMERA, Server, copy_of, error, json, post, read, samples, two_cubes};

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

/// A new frame of the object, half a metre to the side, holds from the next image on, and after a restart.
#[tokio::test]
async fn a_new_reference_takes_effect_at_once_and_stays() {
    let folder = copy_of("reference");
    let arguments = ["--reference", folder.path().to_str().unwrap(), "--recalibration"];
    let server = Server::start(&arguments);
    let before = cube(&server).await;
    let mut pose = value!({
        "rotation_xyzw": before["camera_from_object"]["rotation_xyzw"],
        "translation_m": before["camera_from_object"]["translation_m"],
    });
    let x = pose["translation_m"][0].as_f64().unwrap();
    pose["translation_m"][0] = (x + 0.5).into();
    // Without a box: the detector's.
    let request = value!({"references": [{"camera": "demo", "camera_from_object": pose}]});
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
    let cases = [
        ("teapot", vec![image.clone()], known(&value!({})), StatusCode::NOT_FOUND, "known objects"),
        (
            "cube",
            vec![image.clone(), image.clone()],
            known(&value!({})),
            StatusCode::BAD_REQUEST,
            "2 parts 'image' for 1",
        ),
        ("cube", vec![image.clone()], known(&value!({"colour": 1})), StatusCode::BAD_REQUEST, "colour"),
        ("cube", vec![image.clone()], known(&value!({"camera": "left"})), StatusCode::NOT_FOUND, "left"),
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

#[tokio::test]
async fn it_is_off_unless_allowed() {
    let server = Server::start(&[]);
    let response = put(&server, "cube", &[read(&samples()[0].file)], &value!({"references": []})).await;
    assert_eq!(response.status(), StatusCode::FORBIDDEN);
    assert!(error(response).await.1.contains("--recalibration"));
}
