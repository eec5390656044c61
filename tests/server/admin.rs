//! What operators see.

use reqwest::{Client, StatusCode};
use serde_json::Value;

use crate::support::{CAMERA, Server, copy_of, json, posed, post, read, samples, scene_cameras};

#[tokio::test]
async fn probes_and_the_health_check_answer() {
    let server = Server::start(&[]);
    for probe in ["/livez", "/readyz"] {
        assert_eq!(reqwest::get(server.admin_url(probe)).await.unwrap().status(), StatusCode::OK);
    }
    assert_eq!(reqwest::get(server.url("/v1/nothing")).await.unwrap().status(), StatusCode::NOT_FOUND);
    let check = |address: String| posed(&["healthcheck", "--admin", &address]).output().unwrap();
    assert!(check(server.admin.to_string()).status.success());
    let nobody = check("127.0.0.1:1".into());
    assert_eq!(nobody.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&nobody.stderr).contains("no answer"));
}

/// Without any reference no pose could be given: the server says so instead of taking requests.
#[tokio::test]
async fn a_server_without_calibrated_objects_is_not_ready() {
    let empty = tempfile::tempdir().unwrap();
    let server = Server::start(&["--reference", empty.path().to_str().unwrap()]);
    let response = reqwest::get(server.admin_url("/readyz")).await.unwrap();
    assert_eq!(response.status(), StatusCode::SERVICE_UNAVAILABLE);
    assert!(response.text().await.unwrap().contains("calibrate"));
}

#[tokio::test]
async fn an_object_without_a_reference_is_listed_but_not_served() {
    let reference = copy_of("reference");
    std::fs::remove_file(reference.path().join("cube.json")).unwrap();
    let server = Server::start(&["--reference", reference.path().to_str().unwrap()]);
    let objects = json(reqwest::get(server.url("/v1/objects")).await.unwrap()).await;
    let calibrated = |name: &str| {
        let of_name = |object: &&Value| object["name"] == name;
        objects.as_array().unwrap().iter().find(of_name).unwrap()["calibrated"].clone()
    };
    assert_eq!((calibrated("cube"), calibrated("bracket")), (false.into(), true.into()));
    let image = read(&samples()[0].file);
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    assert!(answer["poses"].as_array().unwrap().iter().all(|pose| pose["object"] != "cube"));
    let asked = post(&server, &format!("{CAMERA}&objects=cube"), image).await;
    assert_eq!(asked.status(), StatusCode::CONFLICT);
    assert_eq!(json(asked).await["error"]["code"], "not_calibrated");
    assert_eq!(reqwest::get(server.url("/v1/objects/teapot")).await.unwrap().status(), StatusCode::NOT_FOUND);
    let bracket = json(reqwest::get(server.url("/v1/objects/bracket")).await.unwrap()).await;
    assert!(bracket["reference"]["sigma_translation_m"].as_f64().unwrap() > 0.0);
}

#[tokio::test]
async fn the_server_says_what_it_knows() {
    let server = Server::start(&["--max-pixels", "1000000"]);
    let cameras = json(reqwest::get(server.url("/v1/cameras")).await.unwrap()).await;
    assert_eq!(cameras["demo"]["fx"], 600.0);
    let rigs = json(reqwest::get(server.url("/v1/rigs")).await.unwrap()).await;
    let listed = rigs["scene"]["cameras"].as_array().unwrap();
    assert_eq!(listed.len(), scene_cameras().len());
    for (listed, pose) in listed.iter().zip(scene_cameras()) {
        // The file names it.
        assert_eq!(listed["camera"], cameras["demo"]);
        let number = |pose: &serde_json::Value, axis: usize| pose["translation_m"][axis].as_f64().unwrap();
        assert!((0..3).all(|axis| (number(&listed["rig_from_camera"], axis) - number(&pose, axis)).abs() < 1e-9));
    }
    let limits = json(reqwest::get(server.url("/v1/limits")).await.unwrap()).await;
    assert_eq!(limits["max_pixels"], 1_000_000);
    let description = json(reqwest::get(server.url("/openapi.json")).await.unwrap()).await;
    assert!(description["paths"]["/v1/poses"]["post"]["responses"]["429"].is_object());
}

#[tokio::test]
async fn metrics_count_requests_objects_and_stages() {
    let server = Server::start(&[]);
    post(&server, CAMERA, read(&samples()[0].file)).await;
    post(&server, CAMERA, b"no image".to_vec()).await;
    reqwest::get(server.url("/v1/nothing")).await.unwrap();
    let text = reqwest::get(server.admin_url("/metrics")).await.unwrap().text().await.unwrap();
    for line in [
        "posed_requests_total{protocol=\"http\",route=\"/v1/poses\",outcome=\"ok\"} 1",
        "posed_requests_total{protocol=\"http\",route=\"/v1/poses\",outcome=\"unsupported_format\"} 1",
        "posed_requests_total{protocol=\"http\",route=\"unknown\",outcome=\"not_found\"} 1",
        "posed_stage_duration_seconds_count{stage=\"pnp\"} 1",
        "posed_queue_dequeued_total{reason=\"worked\"} 1",
        "posed_ready_workers 1",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    assert!(text.contains("posed_objects_total{object=\"cube\",status=\"ok\"}"), "{text}");
    assert!(text.contains("provider=\"cpu\"") || text.contains("provider=\"openvino\""), "{text}");
    assert!(text.ends_with("# EOF\n"));
}

#[tokio::test]
async fn the_status_tells_of_the_last_minute() {
    let server = Server::start(&["--queue", "3"]);
    post(&server, CAMERA, read(&samples()[0].file)).await;
    post(&server, CAMERA, b"no image".to_vec()).await;
    let status = json(reqwest::get(server.url("/v1/status")).await.unwrap()).await;
    assert_eq!((&status["ready"], &status["queue"]["max_images"]), (&true.into(), &3.into()));
    let outcomes = serde_json::json!({"ok": 1, "unsupported_format": 1});
    assert_eq!(status["last_minute"]["outcomes"], outcomes);
    assert!(status["last_minute"]["latency_ms"]["p50"].as_f64().unwrap() > 0.0);
    assert!(["cpu", "openvino"].contains(&status["models"]["provider"].as_str().unwrap()));
    assert_eq!(status["workers"]["ready"], 1);
    let memory = |field: &str| status["memory"][field].as_u64().unwrap();
    assert!(memory("resident_bytes") > 0 && memory("resident_bytes") < memory("bound_bytes"));
}

#[tokio::test]
async fn the_log_level_changes_at_run_time() {
    let server = Server::start(&[]);
    let set = async |filter: &'static str| {
        Client::new().put(server.admin_url("/log-level")).body(filter).send().await.unwrap().status()
    };
    assert_eq!(set("debug").await, StatusCode::OK);
    for slip in ["posed=loudest=of=all", "debgu", "info,posd=debug", ""] {
        assert_eq!(set(slip).await, StatusCode::BAD_REQUEST, "{slip}");
    }
}

#[tokio::test]
async fn marks_of_a_request_come_back() {
    let server = Server::start(&["--log-format", "json"]);
    let trace = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
    let request = Client::new().post(server.url(&format!("/v1/poses?{CAMERA}"))).body(read(&samples()[0].file));
    let response = request.header("x-request-id", "frame-17").header("traceparent", trace).send().await.unwrap();
    assert_eq!(response.headers()["x-request-id"], "frame-17");
    assert_eq!(response.headers()["traceparent"], trace);
    let other = reqwest::get(server.url("/v1/limits")).await.unwrap();
    assert_eq!(other.headers()["x-request-id"].len(), 36);
}

/// The description in the repository is the one that the server gives.
#[test]
fn the_description_is_checked_in() {
    let path = crate::support::root().join("docs/openapi.json");
    let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
    if std::env::var_os("POSED_UPDATE").is_some() {
        std::fs::write(&path, posed::server::openapi()).unwrap();
    } else {
        assert!(checked_in == posed::server::openapi(), "docs/openapi.json is old; `make openapi` writes the new one");
    }
}
