//! Requests that are forms: one image with its options as JSON, or several images.

use nalgebra::Matrix4;
use reqwest::multipart::{Form, Part};
use reqwest::{Client, Response, StatusCode};
use serde_json::{Value, json as value};

use crate::support::{Server, assert_right, assert_still_works, error, json, read, samples};

async fn send(server: &Server, path: &str, form: Form) -> Response {
    Client::new().post(server.url(path)).multipart(form).send().await.unwrap()
}

fn form(images: &[Vec<u8>], request: &str) -> Form {
    let image = |bytes: &Vec<u8>| Part::bytes(bytes.clone()).file_name("image.jpg");
    images.iter().fold(Form::new(), |form, bytes| form.part("image", image(bytes))).text("request", request.to_owned())
}

fn pinhole() -> Value {
    value!({"model": "pinhole", "fx": 600.0, "fy": 600.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480})
}

fn matrix(transform: &Value) -> Matrix4<f64> {
    let rows: [[f64; 4]; 4] = serde_json::from_value(transform["matrix"].clone()).unwrap();
    Matrix4::from_fn(|row, column| rows[row][column])
}

#[tokio::test]
async fn a_form_is_answered_in_the_callers_frames() {
    let server = Server::start(&[]);
    let base_from_camera = value!({"rotation_xyzw": [0.5, -0.5, 0.5, -0.5], "translation_m": [1.0, 2.0, 3.0]});
    for sample in samples() {
        for camera in [pinhole(), value!("demo")] {
            let request = value!({
                "camera": camera, "base_from_camera": base_from_camera, "captured_at": "2026-05-04T12:00:00.123456789Z",
            });
            let response = send(&server, "/v1/poses", form(&[read(&sample.file)], &request.to_string())).await;
            assert_eq!(response.status(), StatusCode::OK);
            let answer = json(response).await;
            assert_right(&sample, &answer);
            assert_eq!(answer["captured_at"], "2026-05-04T12:00:00.123456789Z");
            let pose = &answer["poses"][0];
            // The quaternion above looks along the base's x: camera x to base -y, y to -z, z to x.
            let frame = Matrix4::new(
                0.0, 0.0, 1.0, 1.0, //
                -1.0, 0.0, 0.0, 2.0, //
                0.0, -1.0, 0.0, 3.0, //
                0.0, 0.0, 0.0, 1.0,
            );
            let difference = frame * matrix(&pose["camera_from_object"]) - matrix(&pose["base_from_object"]);
            assert!(difference.amax() < 1e-9, "{difference}");
            // The variance along the camera's z is the one along the base's x.
            let variance = |covariance: &Value, axis: usize| covariance[axis][axis].as_f64().unwrap();
            let (camera, base) = (&pose["covariance"], &pose["base_from_object"]["covariance"]);
            assert!((variance(camera, 2) - variance(base, 0)).abs() < 1e-12);
            assert!(pose["world_from_object"].is_null());
        }
    }
}

/// A lens that bends nothing is no lens; one that bends moves the pose.
#[tokio::test]
async fn a_camera_may_have_a_lens() {
    let server = Server::start(&[]);
    let sample = &samples()[0];
    let answer = async |distortion: [f64; 5]| {
        let mut camera = pinhole();
        camera["model"] = "opencv".into();
        camera["distortion"] = distortion.to_vec().into();
        let request = value!({"camera": camera}).to_string();
        json(send(&server, "/v1/poses", form(&[read(&sample.file)], &request)).await).await
    };
    let plain = answer([0.0; 5]).await;
    assert_right(sample, &plain);
    let bent = answer([0.2, 0.0, 0.0, 0.0, 0.0]).await;
    assert_ne!(plain["poses"][0]["camera_from_object"], bent["poses"][0]["camera_from_object"]);
}

/// Principal points beside the image, and lenses that fold within it: numbers where the schema has numbers.
#[tokio::test]
async fn a_lens_that_ends_within_the_image_leaves_no_gap_in_the_answer() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let mut outside = 0;
    for (cx, k1) in [(319.5, -0.9), (100.0, -0.6), (-100.0, -0.35), (500.0, -0.6), (640.0, -0.5)] {
        let camera = value!({
            "model": "opencv", "fx": 600, "fy": 600, "cx": cx, "cy": 239.5, "skew": 0,
            "distortion": [k1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        });
        let request = value!({"camera": camera}).to_string();
        let answer = json(send(&server, "/v1/poses", form(std::slice::from_ref(&image), &request)).await).await;
        for pose in answer["poses"].as_array().unwrap().iter().filter(|pose| !pose["keypoints"].is_null()) {
            assert!(pose["reprojection_rmse_px"].is_number(), "{pose}");
            let keypoints = pose["keypoints"].as_array().unwrap();
            let without = keypoints.iter().filter(|keypoint| keypoint.get("residual_px").is_none()).count();
            assert!(
                keypoints.iter().all(|keypoint| keypoint.get("residual_px").is_none_or(Value::is_number)),
                "{pose}"
            );
            assert!(
                keypoints.iter().all(|keypoint| keypoint["inlier"] == false || keypoint.get("residual_px").is_some())
            );
            let left_out = pose["keypoints_outside_lens"].as_u64().unwrap();
            assert!(left_out <= without as u64, "{pose}");
            outside += left_out;
        }
    }
    assert!(outside > 0, "no keypoint was beyond a lens");
}

#[tokio::test]
async fn bad_forms_are_refused_by_name_and_the_next_good_one_works() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let with = |request: &str| form(std::slice::from_ref(&image), request);
    let deep = format!("{{\"camera\": {}{}}}", "[".repeat(5000), "]".repeat(5000));
    let mut misspelt = pinhole();
    misspelt["f_x"] = 1.0.into();
    let mut negative = pinhole();
    negative["fy"] = (-600.0).into();
    let mut huge = pinhole();
    huge["fx"] = 1e300.into();
    let mut skewed = pinhole();
    skewed["skew"] = 0.3.into();
    let mut tilted = pinhole();
    tilted["model"] = "opencv".into();
    tilted["distortion"] = [0.0; 13].into_iter().chain([0.01]).collect::<Vec<_>>().into();
    let camera = |camera: &Value| value!({"camera": camera}).to_string();
    let bad = StatusCode::BAD_REQUEST;
    let cases = [
        ("deep", with(&deep), bad, "the id of a registered camera"),
        ("no JSON", with("camera=demo"), bad, "'request'"),
        ("unknown field", with(r#"{"camera": "demo", "colour": "red"}"#), bad, "colour"),
        (
            "short box",
            with(r#"{"camera": "demo", "boxes": [{"object": "cube", "box_px": [1, 2, 3]}]}"#),
            bad,
            "field 'boxes[0].box_px': invalid length 3",
        ),
        ("no camera", with("{}"), bad, "no camera"),
        ("unknown camera", with(r#"{"camera": "left"}"#), StatusCode::NOT_FOUND, "known cameras: demo"),
        ("misspelt camera", with(&camera(&misspelt)), bad, "f_x"),
        ("negative focal length", with(&camera(&negative)), bad, "'fy'"),
        ("impossible focal length", with(&camera(&huge)), bad, "'fx'"),
        ("skew", with(&camera(&skewed)), bad, "'skew' is 0.3"),
        ("tilted sensor", with(&camera(&tilted)), bad, "tau_y = 0.01"),
        ("number out of range", with(r#"{"camera": {"model": "pinhole", "fx": 1e999}}"#), bad, "out of range"),
        ("unknown object", with(r#"{"camera": "demo", "objects": ["teapot"]}"#), StatusCode::NOT_FOUND, "teapot"),
        (
            "no rotation",
            with(r#"{"camera": "demo", "world_from_camera": {"rotation_xyzw": [0,0,0,0], "translation_m": [0,0,0]}}"#),
            bad,
            "world_from_camera",
        ),
        ("long mark", with(&value!({"camera": "demo", "captured_at": "x".repeat(65)}).to_string()), bad, "captured_at"),
        ("two images", form(&[image.clone(), image.clone()], r#"{"camera": "demo"}"#), bad, "2 parts 'image'"),
        ("no image", form(&[], r#"{"camera": "demo"}"#), bad, "0 parts 'image'"),
        ("unknown part", with(r#"{"camera": "demo"}"#).text("extra", "1"), bad, "extra"),
        ("request twice", with(r#"{"camera": "demo"}"#).text("request", "{}"), bad, "twice"),
    ];
    for (name, form, status, words) in cases {
        let response = send(&server, "/v1/poses", form).await;
        assert_eq!(response.status(), status, "{name}");
        let (_, message) = error(response).await;
        assert!(message.contains(words), "{name}: {message}");
    }
    let query_too = send(&server, "/v1/poses?camera=demo", with("{}")).await;
    assert!(error(query_too).await.1.contains("not in the query"));
    let cut = Client::new().post(server.url("/v1/poses")).header("content-type", "multipart/form-data; boundary=x");
    assert_eq!(
        cut.body("--x\r\nContent-Disposition: form-data; name=\"image\"\r\n\r\nabc").send().await.unwrap().status(),
        bad
    );
    assert_still_works(&server).await;
}

/// Each image of a batch has its own status, and its answer is the one that it has alone.
#[tokio::test]
async fn a_batch_is_answered_image_by_image() {
    let server = Server::start(&[]);
    let all = samples();
    let mut images: Vec<Vec<u8>> = all.iter().map(|sample| read(&sample.file)).collect();
    images.insert(1, b"no image".to_vec());
    let shared = json(send(&server, "/v1/poses/batch", form(&images, r#"{"camera": "demo"}"#)).await).await;
    let items = shared["items"].as_array().unwrap();
    let statuses: Vec<_> = items.iter().map(|item| item["status"].as_u64().unwrap()).collect();
    assert_eq!(statuses, [200, 415, 200, 200]);
    assert_eq!(items[1]["error"]["code"], "unsupported_format");
    for (sample, item) in all.iter().zip([&items[0], &items[2], &items[3]]) {
        assert_right(sample, &item["answer"]);
        let alone = json(send(&server, "/v1/poses", form(&[read(&sample.file)], r#"{"camera": "demo"}"#)).await).await;
        for (together, alone) in
            item["answer"]["poses"].as_array().unwrap().iter().zip(alone["poses"].as_array().unwrap())
        {
            assert_eq!((&together["object"], &together["status"]), (&alone["object"], &alone["status"]));
            let difference = matrix(&together["camera_from_object"]) - matrix(&alone["camera_from_object"]);
            assert!(difference.amax() < 1e-3, "{difference}");
        }
    }
    let listed = value!([{"camera": "demo"}, {"camera": "demo"}, {"camera": "left"}, {"objects": 3}]).to_string();
    let items = json(send(&server, "/v1/poses/batch", form(&images, &listed)).await).await;
    let statuses: Vec<_> =
        items["items"].as_array().unwrap().iter().map(|item| item["status"].as_u64().unwrap()).collect();
    assert_eq!(statuses, [200, 415, 404, 400]);
}

#[tokio::test]
async fn bad_batches_are_refused() {
    let server = Server::start(&["--max-batch-images", "2"]);
    let image = read(&samples()[0].file);
    for (images, request, status, words) in [
        (0, r#"{"camera": "demo"}"#, StatusCode::BAD_REQUEST, "no part 'image'"),
        (2, r#"[{"camera": "demo"}]"#, StatusCode::BAD_REQUEST, "1 options for 2 images"),
        (3, r#"{"camera": "demo"}"#, StatusCode::PAYLOAD_TOO_LARGE, "max_batch_images"),
    ] {
        let response = send(&server, "/v1/poses/batch", form(&vec![image.clone(); images], request)).await;
        assert_eq!(response.status(), status);
        let (_, message) = error(response).await;
        assert!(message.contains(words), "{message}");
    }
    assert_still_works(&server).await;
}
