//! Frames as camera drivers give them.

use image::RgbImage;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{EstimateRequest, RawImage, estimate_request::Camera};
use reqwest::multipart::{Form, Part};
use reqwest::{Client, StatusCode};
use serde_json::{Value, json as value};
use tonic::Code;

use crate::support::{Server, assert_right, assert_still_works, error, json, png, post, samples};

fn picture() -> RgbImage {
    image::open(&samples()[0].file).unwrap().into_rgb8()
}

/// BGR rows, each followed by some bytes of padding.
fn bgr8(image: &RgbImage, padding: usize) -> Vec<u8> {
    let row = |row: image::buffer::Pixels<'_, image::Rgb<u8>>| {
        let pixels = row.flat_map(|pixel| [pixel[2], pixel[1], pixel[0]]);
        pixels.chain(std::iter::repeat_n(0xAB, padding)).collect::<Vec<u8>>()
    };
    image.rows().flat_map(row).collect()
}

#[tokio::test]
async fn a_raw_frame_has_the_poses_of_the_same_pixels_as_png() {
    let server = Server::start(&[]);
    let image = picture();
    let as_png = json(post(&server, "camera=demo", png(&image.clone().into())).await).await;
    assert_right(&samples()[0], &as_png);
    for (query, frame) in [
        ("encoding=bgr8&width=640&height=480", bgr8(&image, 0)),
        ("encoding=bgr8&width=640&height=480&step=2000", bgr8(&image, 80)),
        ("encoding=rgb8&width=640&height=480", image.as_raw().clone()),
    ] {
        let answer = json(post(&server, &format!("camera=demo&{query}"), frame).await).await;
        assert_eq!(answer["poses"], as_png["poses"], "{query}");
    }
    // In a form, with a camera that the query could not state.
    let camera =
        value!({"model": "opencv", "fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "distortion": [0, 0, 0, 0]});
    let request = value!({"camera": camera, "raw": {"encoding": "bgr8", "width": 640, "height": 480}}).to_string();
    let part = Part::bytes(bgr8(&image, 0)).file_name("frame");
    let form = Form::new().part("image", part).text("request", request);
    let answer = Client::new().post(server.url("/v1/poses")).multipart(form).send().await.unwrap();
    assert_right(&samples()[0], &json(answer).await);
    // Whatever the content type says.
    let request = Client::new().post(server.url("/v1/poses?camera=demo&encoding=bgr8&width=640&height=480"));
    let answer = request.header("content-type", "application/json").body(bgr8(&image, 0)).send().await.unwrap();
    assert_eq!(json(answer).await["poses"], as_png["poses"]);
}

#[tokio::test]
async fn grpc_takes_raw_frames_too() {
    let server = Server::start(&[]);
    let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let frame = |encoding: &str, width, height, step, data: Vec<u8>| {
        Some(RawImage { encoding: encoding.into(), width, height, step, data: data.into() })
    };
    let image = picture();
    let camera = Some(Camera::CameraId("demo".into()));
    let good = EstimateRequest {
        raw_image: frame("bgr8", 640, 480, 2000, bgr8(&image, 80)),
        camera: camera.clone(),
        ..EstimateRequest::default()
    };
    let raw = client.estimate(good.clone()).await.unwrap().into_inner();
    let encoded = EstimateRequest { image: png(&image.into()).into(), camera, ..EstimateRequest::default() };
    let encoded = client.estimate(encoded).await.unwrap().into_inner();
    assert!(!raw.poses.is_empty());
    assert_eq!(raw.poses, encoded.poses);
    for (request, words) in [
        (EstimateRequest { image: vec![1].into(), ..good.clone() }, "both set"),
        (EstimateRequest { raw_image: frame("bgr9", 640, 480, 0, Vec::new()), ..good.clone() }, "bgr9"),
        (EstimateRequest { raw_image: frame("bgr8", 640, 480, 0, vec![0; 7]), ..good }, "7 bytes"),
    ] {
        let status = client.estimate(request).await.unwrap_err();
        assert!(status.code() == Code::InvalidArgument && status.message().contains(words), "{status}");
    }
}

#[tokio::test]
async fn frames_that_do_not_fit_are_refused_by_name_and_the_next_good_one_works() {
    let server = Server::start(&[]);
    let frame = picture().into_raw();
    let cases = [
        ("encoding=rgb8&width=640&height=481", "bytes"),
        ("encoding=rgb8&width=640&height=480&step=1900", "'step'"),
        ("encoding=rgb8&width=640", "'height'"),
        ("encoding=rgb&width=640&height=480", "known encodings: rgb8"),
        ("encoding=rgb8&width=0&height=480", "at least 1"),
        ("encoding=nv12&width=641&height=480", "multiple of 2"),
        ("width=640&height=480", "'encoding'"),
        ("encoding=mono8&width=4294967295&height=4294967295", "bytes"),
    ];
    for (query, words) in cases {
        let response = post(&server, &format!("camera=demo&{query}"), frame.clone()).await;
        assert_eq!(response.status(), StatusCode::BAD_REQUEST, "{query}");
        let (_, message) = error(response).await;
        assert!(message.contains(words), "{query}: {message}");
    }
    let limits = json(reqwest::get(server.url("/v1/limits")).await.unwrap()).await;
    assert!(limits["raw_encodings"].as_array().unwrap().contains(&Value::from("yuv422_yuy2")));
    assert_still_works(&server).await;
}
