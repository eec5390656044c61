//! One image to `POST /v1/poses`.

use reqwest::{Client, StatusCode};
use serde_json::Value;

use crate::support::{
    CAMERA, Server, assert_right, assert_still_works, error, json, png, post, read, root, samples, two_cubes,
};

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
    let claims_to_be_huge = read(&root().join("tests/data/claims-60000x60000.png"));
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

/// With the limits as they are by default, and a client that does not stop sending.
#[tokio::test]
async fn a_body_of_50_megabytes_is_refused() {
    let server = Server::start(&[]);
    // A client that is cut off while it sends may not come to read the answer.
    if let Ok(response) =
        Client::new().post(server.url(&format!("/v1/poses?{CAMERA}"))).body(vec![0; 50_000_000]).send().await
    {
        assert_eq!(response.status(), StatusCode::PAYLOAD_TOO_LARGE);
        assert!(error(response).await.1.contains("max_body_bytes"));
    }
    assert_still_works(&server).await;
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

/// The camera of a resized image is scaled where the caller says that it is one, and the poses stay where they are. Nothing else
/// tells it from a region of the same shape, whose poses would move.
#[tokio::test]
async fn a_resized_image_has_its_camera_scaled_where_the_caller_says_so() {
    let server = Server::start(&[]);
    let sample = &samples()[0];
    let image = image::open(&sample.file).unwrap();
    let doubled = image.resize_exact(1280, 960, image::imageops::FilterType::CatmullRom);
    let answer = json(post(&server, "camera=demo&allow_resize=true", png(&doubled)).await).await;
    assert_right(sample, &answer);
    assert_eq!(answer["image"]["camera_scaled_from"], serde_json::json!([640, 480]));

    for (query, image, words) in [
        ("camera=demo", doubled, "'allow_resize'"),
        ("camera=demo", image.crop_imm(160, 120, 320, 240), "subtracted from cx and cy"),
        ("camera=demo&allow_resize=true", image.crop_imm(0, 0, 600, 480), "640x480"),
    ] {
        let response = post(&server, query, png(&image)).await;
        assert_eq!(response.status(), StatusCode::BAD_REQUEST, "{query}");
        let message = error(response).await.1;
        assert!(message.contains(words), "{query}: {message}");
    }
}

#[tokio::test]
async fn every_kind_of_pixel_is_answered() {
    let server = Server::start(&[]);
    let sample = &samples()[0];
    let image = image::open(&sample.file).unwrap();
    for colour in [image::DynamicImage::from(image.to_rgba8()), image.to_rgb16().into()] {
        assert_right(sample, &json(post(&server, CAMERA, png(&colour)).await).await);
    }
}

/// Input that cannot be judged is answered, and never trusted.
#[tokio::test]
async fn what_the_networks_never_saw_is_not_ok() {
    let server = Server::start(&[]);
    let image = image::open(&samples()[0].file).unwrap();
    let mut dark = image.to_rgb8();
    dark.iter_mut().for_each(|level| *level /= 16);
    for (query, image, reason) in [
        (CAMERA, image.to_luma8().into(), "grey_image"),
        (CAMERA, dark.into(), "dark_image"),
        // Those of a whole sensor for a region in its corner.
        ("fx=600&fy=600&cx=20&cy=239.5", image.clone(), "camera_suspect"),
        // Of a lens of 4.2 mm, in millimetres.
        ("fx=4.2&fy=4.2&cx=319.5&cy=239.5", image, "camera_suspect"),
    ] {
        let answer = json(post(&server, query, png(&image)).await).await;
        let poses = answer["poses"].as_array().unwrap();
        assert!(poses.iter().all(|pose| pose["status"] != "ok"), "{query}: {answer}");
        if reason != "dark_image" {
            let reasons = poses.iter().map(|pose| pose["reasons"].to_string()).collect::<Vec<_>>().join(" ");
            assert!(reasons.contains(reason), "{query}: {reasons}");
        }
    }
}

/// A phone's photo: stored as the sensor read it, to be turned before it is looked at.
#[tokio::test]
async fn a_turned_image_is_refused_applied_or_ignored_as_the_server_is_set() {
    let sample = &samples()[0];
    let jpeg = read(&sample.file);
    // An EXIF segment that states orientation 3, a half turn.
    let exif = b"\xFF\xE1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x03\0\0\0\0\0\0\0";
    let turned = [&jpeg[..2], exif, &jpeg[2..]].concat();
    let server = Server::start(&[]);
    let response = post(&server, CAMERA, turned.clone()).await;
    assert_eq!(response.status(), StatusCode::BAD_REQUEST);
    assert!(error(response).await.1.contains("orientation 3"));
    let server = Server::start(&["--exif-orientation", "ignore"]);
    let answer = json(post(&server, CAMERA, turned.clone()).await).await;
    assert_right(sample, &answer);
    assert_eq!(answer["image"]["exif"], serde_json::json!({"orientation": 3, "applied": false}));
    let server = Server::start(&["--exif-orientation", "apply"]);
    let answer = json(post(&server, CAMERA, turned).await).await;
    assert_eq!(answer["image"]["exif"]["applied"], true);
    // The cube is where it was, but for the half turn of the picture.
    let x = |answer: &Value| {
        let cube = answer["poses"].as_array().unwrap().iter().find(|pose| pose["object"] == "cube").unwrap().clone();
        cube["camera_from_object"]["translation_m"][0].as_f64().unwrap()
    };
    assert!((x(&answer) + x(&json(post(&server, CAMERA, jpeg).await).await)).abs() < 0.02);
}

#[tokio::test]
async fn a_picture_is_given_where_one_is_accepted() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let url = server.url(&format!("/v1/poses?{CAMERA}"));
    for (accept, format) in
        [("image/png", image::ImageFormat::Png), ("text/html, image/jpeg;q=0.9", image::ImageFormat::Jpeg)]
    {
        let response = Client::new().post(&url).header("accept", accept).body(image.clone()).send().await.unwrap();
        assert_eq!(response.headers()["content-type"], format.to_mime_type());
        let bytes = response.bytes().await.unwrap();
        let picture = image::load_from_memory_with_format(&bytes, format).unwrap().into_rgb8();
        let plain = image::load_from_memory(&image).unwrap().into_rgb8();
        let changed =
            picture.pixels().zip(plain.pixels()).filter(|(a, b)| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > 60));
        assert!(changed.count() > 500);
    }
}

/// Preferences are weighed (RFC 9110, section 12.5.1).
#[tokio::test]
async fn json_is_given_where_it_is_preferred() {
    let server = Server::start(&[]);
    let url = server.url(&format!("/v1/poses?{CAMERA}"));
    for accept in ["application/json, image/png;q=0.1", "image/png;q=0.4, application/*;q=0.5", "*/*", "image/png;q=0"]
    {
        let request = Client::new().post(&url).header("accept", accept).body(read(&samples()[0].file));
        let response = request.send().await.unwrap();
        assert_eq!(response.headers()["content-type"], "application/json", "{accept}");
    }
}

#[tokio::test]
async fn a_selection_is_kept() {
    let server = Server::start(&[]);
    let poses = async |query: &str| -> Vec<Value> {
        let answer = json(post(&server, &format!("{CAMERA}&{query}"), two_cubes()).await).await;
        answer["poses"].as_array().unwrap().clone()
    };
    let count = |poses: &[Value], object: &str| poses.iter().filter(|pose| pose["object"] == object).count();
    let all = poses("").await;
    assert!(count(&all, "cube") >= 2, "{all:?}");
    assert_eq!(count(&poses("max_instances=1").await, "cube"), 1);
    let cubes = poses("objects=cube,bracket").await;
    assert_eq!(count(&cubes, "cube") + count(&cubes, "bracket"), cubes.len());
    assert_eq!(count(&poses("objects=bracket").await, "cube"), 0);
    let confidence = |pose: &Value| pose["confidence"].as_f64().unwrap();
    let mut confidences: Vec<f64> = all.iter().map(confidence).collect();
    confidences.sort_by(f64::total_cmp);
    let limit = f64::midpoint(confidences[0], confidences[confidences.len() - 1]);
    let sure = poses(&format!("min_confidence={limit}")).await;
    assert_eq!(sure.len(), confidences.iter().filter(|confidence| **confidence >= limit).count());
    assert!(sure.len() < all.len() && sure.iter().all(|pose| confidence(pose) >= limit));
}

#[tokio::test]
async fn bad_options_are_refused_by_name() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    for (query, status, code, words) in [
        ("objects=", StatusCode::BAD_REQUEST, "invalid_request", "'objects' is empty"),
        ("objects=teapot", StatusCode::NOT_FOUND, "unknown_object", "known objects: bracket, cube"),
        ("max_instances=0", StatusCode::BAD_REQUEST, "invalid_request", "max_instances"),
        ("max_instances=-1", StatusCode::BAD_REQUEST, "invalid_request", "max_instances"),
        ("min_confidence=1.5", StatusCode::BAD_REQUEST, "invalid_request", "min_confidence"),
        ("min_confidence=NaN", StatusCode::BAD_REQUEST, "invalid_request", "min_confidence"),
    ] {
        let response = post(&server, &format!("{CAMERA}&{query}"), image.clone()).await;
        assert_eq!(response.status(), status, "{query}");
        let (found, message) = error(response).await;
        assert!(found == code && message.contains(words), "{query}: {found} {message}");
    }
    let url = server.url(&format!("/v1/poses?{CAMERA}"));
    let strange = Client::new().post(&url).header("content-type", "application/json").body("{}").send().await.unwrap();
    assert_eq!(strange.status(), StatusCode::UNSUPPORTED_MEDIA_TYPE);
    assert!(error(strange).await.1.contains("multipart/form-data"));
    let wrong_method = reqwest::get(server.url("/v1/poses")).await.unwrap();
    assert_eq!(wrong_method.status(), StatusCode::METHOD_NOT_ALLOWED);
    assert_still_works(&server).await;
}

#[tokio::test]
async fn nothing_in_view_is_an_empty_list() {
    let server = Server::start(&[]);
    let grey = image::GrayImage::from_pixel(640, 480, image::Luma([120]));
    let response = post(&server, CAMERA, png(&grey.into())).await;
    assert_eq!(response.status(), StatusCode::OK);
    assert_eq!(json(response).await["poses"], Value::Array(Vec::new()));
}
