//! What the server says of its models: references that do not belong to them, limits, and answers that reached one.

use posed::proto::estimate_request::Camera;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{EstimateRequest, ListObjectsRequest};
use reqwest::StatusCode;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json as value};

use crate::support::{CAMERA, Server, change, copy_of, error, json, post, read, samples};

async fn get(server: &Server, path: &str) -> Value {
    json(reqwest::get(server.url(path)).await.unwrap()).await
}

async fn client(server: &Server) -> PoseServiceClient<tonic::transport::Channel> {
    PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap()
}

fn objects(answer: &Value) -> Vec<&str> {
    answer["poses"].as_array().unwrap().iter().map(|pose| pose["object"].as_str().unwrap()).collect()
}

/// One object that was trained anew does not stop the others.
#[tokio::test]
async fn an_object_whose_reference_belongs_to_another_network_goes_without() {
    let folder = copy_of("reference");
    change(&folder.path().join("cube.json"), |json| json["keypoint_model_sha256"] = "0".repeat(64).into());
    let server = Server::start(&["--reference", folder.path().to_str().unwrap(), "--recalibration"]);
    let image = read(&samples()[0].file);
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    assert!(objects(&answer).len() >= 2 && !objects(&answer).contains(&"cube"), "{answer}");

    let cube = get(&server, "/v1/objects/cube").await;
    let problem = cube["reference_problem"].as_str().unwrap();
    assert_eq!(cube["calibrated"], false);
    assert!(problem.contains("another keypoint net") && problem.contains("posed calibrate cube"), "{problem}");
    let link = get(&server, "/v1/objects/link").await;
    assert!(link["calibrated"] == true && link["reference_problem"].is_null());
    let listed = client(&server).await.list_objects(ListObjectsRequest {}).await.unwrap().into_inner().objects;
    assert!(listed.iter().all(|object| object.calibrated == object.reference_problem.is_empty()));
    let refused = post(&server, &format!("{CAMERA}&objects=cube"), image.clone()).await;
    assert_eq!(refused.status(), StatusCode::CONFLICT);
    assert!(error(refused).await.1.contains("another keypoint net"));

    let known = samples().into_iter().next().unwrap().objects;
    let [x, y, z] = [0.1, 0.2, 0.7];
    let box_px = answer["poses"][0]["detection"]["box_px"].clone();
    assert!(known.iter().any(|known| known.object == "cube") && box_px.is_array());
    let pose = value!({"rotation_xyzw": [0, 0, 0, 1], "translation_m": [x, y, z]});
    let request = value!({"references": [{"camera": "demo", "camera_from_object": pose}], "far_origin": true});
    let form =
        Form::new().part("image", Part::bytes(image.clone()).file_name("image")).text("request", request.to_string());
    let url = server.url("/v1/objects/cube/reference");
    assert_eq!(reqwest::Client::new().put(url).multipart(form).send().await.unwrap().status(), StatusCode::OK);
    let cube = get(&server, "/v1/objects/cube").await;
    assert!(cube["calibrated"] == true && cube["reference_problem"].is_null(), "{cube}");
    assert!(objects(&json(post(&server, CAMERA, image).await).await).contains(&"cube"));
}

/// A detector that states how many boxes it returns at most: so many mean that there may be more.
#[tokio::test]
async fn an_answer_says_when_a_limit_was_reached() {
    let image = read(&samples()[0].file);
    let models = copy_of("models");
    for (most, truncated) in [(32, false), (1, true)] {
        change(&models.path().join("detector/detector.json"), |json| json["max_detections"] = most.into());
        let server = Server::start(&["--models", models.path().to_str().unwrap()]);
        assert_eq!(get(&server, "/v1/limits").await["max_detections"], 32);
        assert_eq!(json(post(&server, CAMERA, image.clone()).await).await["truncated"], truncated);
        let request = EstimateRequest {
            image: image.clone().into(),
            camera: Some(Camera::CameraId("demo".into())),
            ..EstimateRequest::default()
        };
        assert_eq!(client(&server).await.estimate(request).await.unwrap().into_inner().truncated, truncated);
    }
}
