//! The HTTP interface of the real server, with the shipped models.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod support;

use std::time::Duration;

use reqwest::{Client, Response, StatusCode};
use serde_json::Value;
use support::{CAMERA, Server, assert_right, read, samples};

async fn post(server: &Server, query: &str, body: Vec<u8>) -> Response {
    let url = server.url(&format!("/v1/poses?{query}"));
    Client::new().post(url).body(body).send().await.unwrap()
}

async fn json(response: Response) -> Value {
    serde_json::from_slice(&response.bytes().await.unwrap()).unwrap()
}

/// The server still answers the first sample right.
async fn assert_still_works(server: &Server) {
    let sample = &samples()[0];
    let response = post(server, CAMERA, read(&sample.file)).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert_right(sample, &json(response).await);
}

#[tokio::test]
async fn every_sample_is_answered_right() {
    let server = Server::start(&[]);
    for sample in samples() {
        for query in [CAMERA, "camera=demo"] {
            let response = post(&server, query, read(&sample.file)).await;
            assert_eq!(response.status(), StatusCode::OK);
            let answer = json(response).await;
            assert_right(&sample, &answer);
            assert_eq!(answer["image"]["width"], 640);
            for pose in answer["poses"].as_array().unwrap() {
                let matrix = &pose["camera_from_object"]["matrix"];
                let translation = &pose["camera_from_object"]["translation_m"];
                assert_eq!(matrix[2][3], translation[2]);
                assert!(pose["covariance"][2][2].as_f64().unwrap() > 0.0);
                assert!(pose["detection"]["score"].as_f64().unwrap() > 0.0);
            }
        }
    }
}

#[tokio::test]
async fn same_image_same_answer() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let first = json(post(&server, CAMERA, image.clone()).await).await;
    let second = json(post(&server, CAMERA, image).await).await;
    assert_eq!(first["poses"], second["poses"]);
}

#[tokio::test]
async fn bad_images_are_refused_and_the_next_good_one_works() {
    let server = Server::start(&["--max-body-bytes", "2000000"]);
    let whole = read(&samples()[0].file);
    // 65 bytes whose header states 60,000 x 60,000 pixels.
    let claims_to_be_huge = read(&support::root().join("tests/data/claims-60000x60000.png"));
    let cases: [(&str, Vec<u8>, StatusCode, &str); 6] = [
        ("empty", Vec::new(), StatusCode::BAD_REQUEST, "empty"),
        ("text", b"hello, this is no image".to_vec(), StatusCode::UNSUPPORTED_MEDIA_TYPE, "JPEG, PNG or WebP"),
        ("truncated", whole[..whole.len() / 2].to_vec(), StatusCode::BAD_REQUEST, "truncated"),
        ("damaged", [&whole[..300], &[0x55; 400][..], b"\xFF\xD9"].concat(), StatusCode::BAD_REQUEST, "image"),
        ("huge header", claims_to_be_huge, StatusCode::PAYLOAD_TOO_LARGE, "60000x60000"),
        ("huge body", vec![0; 2_000_001], StatusCode::PAYLOAD_TOO_LARGE, "2000000 bytes"),
    ];
    for (name, body, status, words) in cases {
        let response = post(&server, CAMERA, body).await;
        assert_eq!(response.status(), status, "{name}");
        let answer = json(response).await;
        let message = answer["error"]["message"].as_str().unwrap();
        assert!(message.contains(words), "{name}: {message}");
        assert_still_works(&server).await;
    }
}

#[tokio::test]
async fn bad_cameras_are_refused_by_name() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let cases = [
        ("camera=nowhere", StatusCode::NOT_FOUND, "known cameras: demo"),
        ("", StatusCode::BAD_REQUEST, "no camera"),
        ("fx=600&fy=600&cx=320", StatusCode::BAD_REQUEST, "'cy'"),
        ("fx=NaN&fy=600&cx=320&cy=240", StatusCode::BAD_REQUEST, "'fx'"),
        ("fx=600&fy=-5&cx=320&cy=240", StatusCode::BAD_REQUEST, "'fy'"),
        ("fx=600&fy=600&cx=inf&cy=240", StatusCode::BAD_REQUEST, "'cx'"),
        ("camera=demo&fx=1", StatusCode::BAD_REQUEST, "not both"),
        ("camera=demo&colour=red", StatusCode::BAD_REQUEST, "colour"),
    ];
    for (query, status, words) in cases {
        let response = post(&server, query, image.clone()).await;
        assert_eq!(response.status(), status, "{query}");
        let answer = json(response).await;
        let message = answer["error"]["message"].as_str().unwrap();
        assert!(message.contains(words), "{query}: {message}");
    }
    assert_still_works(&server).await;
}

#[tokio::test]
async fn a_camera_of_another_size_is_refused() {
    let server = Server::start(&[]);
    let mut smaller = std::io::Cursor::new(Vec::new());
    let image = image::open(&samples()[0].file).unwrap().thumbnail_exact(320, 240);
    image.write_to(&mut smaller, image::ImageFormat::Png).unwrap();
    let response = post(&server, "camera=demo", smaller.into_inner()).await;
    assert_eq!(response.status(), StatusCode::BAD_REQUEST);
    let answer = json(response).await;
    assert!(answer["error"]["message"].as_str().unwrap().contains("640x480"));
}

#[tokio::test]
async fn nothing_in_view_is_an_empty_list() {
    let server = Server::start(&[]);
    let mut grey = std::io::Cursor::new(Vec::new());
    image::GrayImage::from_pixel(640, 480, image::Luma([120])).write_to(&mut grey, image::ImageFormat::Png).unwrap();
    let response = post(&server, CAMERA, grey.into_inner()).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert_eq!(json(response).await["poses"], Value::Array(Vec::new()));
}

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_recovers() {
    let server = Server::start(&["--queue", "2"]);
    let image = read(&samples()[0].file);
    let requests = (0..20).map(|_| post(&server, CAMERA, image.clone()));
    let mut answered = 0;
    let mut refused = 0;
    for response in futures::future::join_all(requests).await {
        match response.status() {
            StatusCode::OK => answered += 1,
            StatusCode::TOO_MANY_REQUESTS => {
                assert_eq!(response.headers()["retry-after"], "1");
                assert_eq!(json(response).await["error"]["code"], "queue_full");
                refused += 1;
            }
            other => panic!("{other}"),
        }
    }
    assert!(answered >= 2 && refused > 0, "{answered} answered, {refused} refused");
    assert_still_works(&server).await;
}

#[tokio::test]
async fn probes_answer() {
    let server = Server::start(&[]);
    for probe in ["/livez", "/readyz"] {
        assert_eq!(reqwest::get(server.url(probe)).await.unwrap().status(), StatusCode::OK);
    }
    assert_eq!(reqwest::get(server.url("/v1/nothing")).await.unwrap().status(), StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_shutdown_loses_no_accepted_request() {
    let mut server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let (url, client) = (server.url(&format!("/v1/poses?{CAMERA}")), Client::new());
    let requests: Vec<_> = (0..8).map(|_| tokio::spawn(client.post(&url).body(image.clone()).send())).collect();
    // Enough for all to be accepted, not for all to be answered.
    tokio::time::sleep(Duration::from_millis(150)).await;
    server.signal("-TERM");
    for request in requests {
        assert_eq!(request.await.unwrap().unwrap().status(), StatusCode::OK);
    }
    assert!(server.wait(Duration::from_secs(20)).success());
}
