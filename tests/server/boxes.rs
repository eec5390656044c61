//! Boxes that a request brings along, in place of the detector's, and what an answer says of what it lacks.

use posed::proto::estimate_request::Camera;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{BoundingBox, EstimateRequest, ObjectBox};
use reqwest::multipart::{Form, Part};
use reqwest::{Client, StatusCode};
use serde_json::{Value, json as value};

use crate::support::{
    CAMERA, Server, assert_right, assert_still_works, change, copy_of, error, json, post, read, samples,
};

fn form(images: &[&[u8]], request: &Value) -> Form {
    let image = |bytes: &[u8]| Part::bytes(bytes.to_vec()).file_name("image.jpg");
    images.iter().fold(Form::new(), |form, bytes| form.part("image", image(bytes))).text("request", request.to_string())
}

async fn send(server: &Server, path: &str, images: &[&[u8]], request: &Value) -> reqwest::Response {
    Client::new().post(server.url(path)).multipart(form(images, request)).send().await.unwrap()
}

/// What the detector finds, as boxes of a request.
fn boxes_of(answer: &Value) -> Vec<Value> {
    let poses = answer["poses"].as_array().unwrap().iter();
    poses.map(|pose| value!({"object": pose["object"], "box_px": pose["detection"]["box_px"]})).collect()
}

fn hints(answer: &Value) -> Vec<&str> {
    answer["hints"].as_array().map_or(Vec::new(), |hints| hints.iter().map(|hint| hint.as_str().unwrap()).collect())
}

/// Models whose detector knows some objects no longer.
fn models_without_labels(names: &[&str]) -> tempfile::TempDir {
    let models = copy_of("models");
    change(&models.path().join("detector/detector.json"), |json| {
        for label in json["labels"].as_array_mut().unwrap() {
            if names.iter().any(|name| label == name) {
                *label = Value::Null;
            }
        }
    });
    models
}

/// A form, a query, a batch and a message, each with the boxes of the detector, in another order.
#[tokio::test]
async fn given_boxes_are_answered_like_detections() {
    let server = Server::start(&[]);
    let (sample, image) = (&samples()[0], read(&samples()[0].file));
    let detected = json(post(&server, CAMERA, image.clone()).await).await;
    let mut boxes = boxes_of(&detected);
    boxes.reverse();
    let check = |answer: &Value| {
        assert_right(sample, answer);
        let poses = answer["poses"].as_array().unwrap();
        assert_eq!(poses.len(), boxes.len());
        for pose in poses {
            let given = &boxes[usize::try_from(pose["detection"]["given_box"].as_u64().unwrap()).unwrap()];
            assert_eq!(pose["object"], given["object"]);
            assert_eq!((&pose["detection"]["box_px"], &pose["detection"]["score"]), (&given["box_px"], &value!(1.0)));
        }
    };
    let request = value!({"camera": "demo", "boxes": boxes});
    check(&json(send(&server, "/v1/poses", &[&image], &request).await).await);
    assert!(detected["poses"].as_array().unwrap().iter().all(|pose| pose["detection"]["given_box"].is_null()));

    let as_text = |one: &Value| {
        let numbers: Vec<f64> = serde_json::from_value(one["box_px"].clone()).unwrap();
        format!(
            "{}:{}",
            one["object"].as_str().unwrap(),
            numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
        )
    };
    let query = format!("{CAMERA}&boxes={}", boxes.iter().map(as_text).collect::<Vec<_>>().join(";"));
    check(&json(post(&server, &query, image.clone()).await).await);

    let listed = value!([request, {"camera": "demo"}]);
    let batch = json(send(&server, "/v1/poses/batch", &[&image, &image], &listed).await).await;
    check(&batch["items"][0]["answer"]);
    assert!(batch["items"][1]["answer"]["poses"][0]["detection"]["given_box"].is_null());
    let shared = send(&server, "/v1/poses/batch", &[&image, &image], &request).await;
    assert!(error(shared).await.1.contains("each with its own boxes"));

    let message = EstimateRequest {
        image: image.into(),
        camera: Some(Camera::CameraId("demo".into())),
        boxes: boxes.iter().map(of_message).collect(),
        ..EstimateRequest::default()
    };
    let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let poses = client.estimate(message).await.unwrap().into_inner().poses;
    assert_eq!(poses.len(), boxes.len());
    assert!(poses.iter().all(|pose| boxes[pose.given_box.unwrap() as usize]["object"] == pose.object.as_str()));
}

fn of_message(one: &Value) -> ObjectBox {
    let [x_px, y_px, width_px, height_px] = serde_json::from_value(one["box_px"].clone()).unwrap();
    ObjectBox {
        object: one["object"].as_str().unwrap().into(),
        r#box: Some(BoundingBox { x_px, y_px, width_px, height_px }),
    }
}

/// A box that lies where nothing is has a pose that nobody trusts; one that reaches beyond the image is cut.
#[tokio::test]
async fn boxes_need_not_be_right_but_in_the_image() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let ask =
        async |boxes: Value| send(&server, "/v1/poses", &[&image], &value!({"camera": "demo", "boxes": boxes})).await;
    let cut = json(ask(value!([{"object": "cube", "box_px": [-50, -40, 100, 100]}])).await).await;
    assert_eq!(cut["poses"][0]["detection"]["box_px"], value!([0.0, 0.0, 50.0, 60.0]));
    assert_ne!(cut["poses"][0]["status"], "ok");
    let one = |box_px: Value| value!([{"object": "cube", "box_px": box_px}]);
    let many = value!(vec![one(value!([0, 0, 50, 50]))[0].clone(); 33]);
    for (boxes, status, words) in [
        (one(value!([700, 10, 50, 50])), StatusCode::BAD_REQUEST, "'boxes[0].box_px' is [700.0, 10.0, 50.0, 50.0]"),
        (one(value!([10, 10, -50, 50])), StatusCode::BAD_REQUEST, "sides from 2"),
        (one(value!([10, 10, 1, 50])), StatusCode::BAD_REQUEST, "sides from 2"),
        (one(value!([1e9, 10, 50, 50])), StatusCode::BAD_REQUEST, "boxes[0]"),
        (one(value!([10, 10, 50])), StatusCode::BAD_REQUEST, "'request'"),
        (value!([{"object": "teapot", "box_px": [10, 10, 50, 50]}]), StatusCode::NOT_FOUND, "known objects: bracket"),
        (value!([{"object": "cube", "box_px": [10, 10, 50, 50], "score": 1}]), StatusCode::BAD_REQUEST, "score"),
        (value!([]), StatusCode::BAD_REQUEST, "'boxes' is empty"),
        (many, StatusCode::PAYLOAD_TOO_LARGE, "33 boxes, but the limit is 32 ('max_detections')"),
    ] {
        let response = ask(boxes.clone()).await;
        let found = response.status();
        let (_, message) = error(response).await;
        assert!(found == status && message.contains(words), "{boxes}: {found} {message}");
    }
    let both = value!({"camera": "demo", "objects": ["cube"], "boxes": one(value!([10, 10, 50, 50]))});
    assert!(error(send(&server, "/v1/poses", &[&image], &both).await).await.1.contains("not both"));
    for query in ["boxes=cube:1,2,3", "boxes=cube", "boxes=cube:a,b,c,d"] {
        let refused = post(&server, &format!("{CAMERA}&{query}"), image.clone()).await;
        assert!(error(refused).await.1.contains("OBJECT:X,Y,WIDTH,HEIGHT"), "{query}");
    }
    assert_still_works(&server).await;
}

/// The server says at its start, to probes, in lists and in answers that nothing looks for an object; its box is all it needs.
#[tokio::test]
async fn an_object_without_a_label_needs_its_box() {
    let (sample, image) = (&samples()[0], read(&samples()[0].file));
    let boxes = boxes_of(&json(post(&Server::start(&[]), CAMERA, image.clone()).await).await);
    let models = models_without_labels(&["cube"]);
    let server = Server::start(&["--models", models.path().to_str().unwrap()]);
    server.until_logged("object cube is not in the detector's labels").await;
    let ready = reqwest::get(server.admin_url("/readyz")).await.unwrap();
    assert_eq!(ready.status(), StatusCode::OK);
    assert_eq!(ready.text().await.unwrap(), "ready\ncube: not in the detector's labels\n");
    let get = async |name: &str| json(reqwest::get(server.url(&format!("/v1/objects/{name}"))).await.unwrap()).await;
    assert!(get("cube").await["detector_sha256"].is_null() && get("motor").await["detector_sha256"].is_string());

    let answer = json(post(&server, &format!("{CAMERA}&objects=cube,motor"), image.clone()).await).await;
    assert_eq!(hints(&answer), ["cube: not in the detector's labels; send its box ('boxes')"]);
    assert_eq!(answer["poses"][0]["object"], "motor");
    let unasked = json(post(&server, CAMERA, image.clone()).await).await;
    assert!(hints(&unasked).is_empty() && !unasked["poses"].as_array().unwrap().is_empty());
    let answer = json(send(&server, "/v1/poses", &[&image], &value!({"camera": "demo", "boxes": boxes})).await).await;
    assert_right(sample, &answer);
    assert!(hints(&answer).is_empty());
}

/// Without any detector all is as the boxes say.
#[tokio::test]
async fn a_server_may_have_no_detector() {
    let (sample, image) = (&samples()[0], read(&samples()[0].file));
    let boxes = boxes_of(&json(post(&Server::start(&[]), CAMERA, image.clone()).await).await);
    let models = copy_of("models");
    std::fs::remove_dir_all(models.path().join("detector")).unwrap();
    let server = Server::start(&["--models", models.path().to_str().unwrap()]);
    let answer = json(send(&server, "/v1/poses", &[&image], &value!({"camera": "demo", "boxes": boxes})).await).await;
    assert_right(sample, &answer);
    assert!(answer["models"]["detector"].is_null() && answer["models"]["keypoints"]["cube"].is_string());
    let empty = json(post(&server, CAMERA, image).await).await;
    assert!(empty["poses"].as_array().unwrap().is_empty());
    let hints = hints(&empty);
    assert!(hints.contains(&"there is no detector; send 'boxes'") && hints.len() == 5, "{hints:?}");
}

#[tokio::test]
async fn an_empty_answer_says_why() {
    let reference = copy_of("reference");
    change(&reference.path().join("link.json"), |json| json["keypoint_model_sha256"] = "0".repeat(64).into());
    let server = Server::start(&["--reference", reference.path().to_str().unwrap()]);
    let empty = crate::support::png(&image::DynamicImage::ImageRgb8(image::RgbImage::from_fn(640, 480, |x, y| {
        image::Rgb([90, u8::try_from(x / 4).unwrap(), u8::try_from(y / 4).unwrap()])
    })));
    let answer = json(post(&server, CAMERA, empty.clone()).await).await;
    let said = hints(&answer);
    assert!(said.contains(&"no detection above the threshold (0.4)"), "{said:?}");
    assert!(said.iter().any(|hint| hint.starts_with("link: its reference belongs to another")), "{said:?}");
    let answer = json(post(&server, &format!("{CAMERA}&objects=cube"), empty.clone()).await).await;
    assert_eq!(hints(&answer), ["cube: no detection above the threshold (0.4)"]);
    let image = read(&samples()[0].file);
    let sure = json(post(&server, &format!("{CAMERA}&min_confidence=1&objects=cube"), image).await).await;
    assert_eq!(hints(&sure), ["cube: 1 found, none with 'min_confidence' (1)"]);
    let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let request = EstimateRequest {
        image: empty.into(),
        camera: Some(Camera::CameraId("demo".into())),
        objects: vec!["motor".into()],
        ..EstimateRequest::default()
    };
    let answer = client.estimate(request).await.unwrap().into_inner();
    assert_eq!(answer.hints, ["motor: no detection above the threshold (0.4)"]);
}

/// The cube's folder brings a detector along: the shared one, which knows the cube, too, leaves it to that.
#[tokio::test]
async fn several_detectors_look_side_by_side() {
    let (sample, image) = (&samples()[0], read(&samples()[0].file));
    let models = copy_of("models");
    let own = models.path().join("cube/detector");
    std::fs::create_dir(&own).unwrap();
    for file in ["detector.json", "detector.onnx"] {
        std::fs::copy(models.path().join("detector").join(file), own.join(file)).unwrap();
    }
    change(&own.join("detector.json"), |json| {
        json["labels"] = value!(["cube", null, null, null]);
        json["score_threshold"] = 0.3.into();
    });
    let folder = models.path().to_str().unwrap().to_owned();
    let server = Server::start(&["--models", &folder]);
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    assert_right(sample, &answer);
    let cubes = answer["poses"].as_array().unwrap().iter().filter(|pose| pose["object"] == "cube").count();
    assert_eq!(cubes, 1, "{answer}");
    assert_eq!(answer["models"]["own_detectors"]["cube"], answer["models"]["detector"]);
    // Each says its own threshold.
    let empty = crate::support::png(&image::DynamicImage::ImageRgb8(image::RgbImage::new(640, 480)));
    let answer = json(post(&server, &format!("{CAMERA}&objects=cube,motor"), empty).await).await;
    let said = ["cube: no detection above the threshold (0.3)", "motor: no detection above the threshold (0.4)"];
    assert_eq!(hints(&answer), said);
    let metrics = crate::support::metrics(&server).await;
    assert!(metrics.contains("model=\"cube/detector\"") && metrics.contains("model=\"detector\""));
    drop(server);

    change(&own.join("detector.json"), |json| json["labels"] = value!(["motor", null, null, null]));
    crate::support::refuses_to_serve(&["--models", &folder], "its labels [\"motor\"] do not have \"cube\"");
}
