//! A network that never ends, as with a driver that hangs.

use std::path::Path;

use reqwest::{Client, StatusCode};
use serde_json::{Value, json as value};

use crate::bundle::{Bundle, sha256};
use crate::objects::{Folders, put};
use crate::recalibration;
use crate::support::{CAMERA, Server, copy_of, error, json, png, posed, post, read, samples};

#[tokio::test]
async fn a_network_that_hangs_is_named_and_nobody_waits_for_it() {
    let (models, references) = (copy_of("models"), copy_of("reference"));
    make_it_hang(models.path(), references.path());
    let [models, references] = [&models, &references].map(|folder| folder.path().to_str().unwrap());
    let server = Server::start(&["--models", models, "--reference", references, "--worker-timeout-ms", "8000"]);
    let image = image::open(&samples()[0].file).unwrap().into_rgb8();
    let bright = read(&samples()[0].file);
    assert_eq!(post(&server, CAMERA, bright.clone()).await.status(), StatusCode::OK);
    let mut dark = image;
    dark.iter_mut().for_each(|value| *value = *value / 20 * 7);
    let request = Client::new().post(server.url(&format!("/v1/poses?{CAMERA}"))).body(png(&dark.into()));
    let response = request.header("x-request-timeout-ms", "3000").send().await.unwrap();
    assert_eq!(response.status(), StatusCode::GATEWAY_TIMEOUT);
    server.until_logged("is taken out").await;
    let log = server.log();
    assert!(log.contains("object cube") && log.contains("'worker_timeout_ms'"), "{log}");
    let ready = reqwest::get(server.admin_url("/readyz")).await.unwrap();
    assert_eq!(ready.status(), StatusCode::SERVICE_UNAVAILABLE);
    assert!(ready.text().await.unwrap().contains("hang"));
    let check = posed(&["healthcheck", "--admin", &server.admin.to_string()]).output().unwrap();
    assert!(!check.status.success());
    // At once, instead of at its deadline.
    let refused = post(&server, CAMERA, bright).await;
    assert_eq!(refused.status(), StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(error(refused).await.0, "unavailable");
    let status = json(reqwest::get(server.url("/v1/status")).await.unwrap()).await;
    assert_eq!((&status["ready"], &status["workers"]["ready"]), (&false.into(), &0.into()));
    server.until_counted("posed_worker_timeouts_total 1").await;
}

/// A change that hangs is given up, and keeps nobody from another one.
#[tokio::test]
async fn an_object_whose_network_never_ends_stops_nobody_else() {
    let folders = Folders::without_cube();
    let limits = ["--timeout-ms", "4000", "--max-timeout-ms", "4000", "--worker-timeout-ms", "2000"];
    let server = folders.serve(&[&["--object-changes", "--recalibration"], &limits[..]].concat());
    let mut bundle = Bundle::of("cube").without(&["parity", "reference"]);
    let network = hanging(&bundle.files["keypoints.onnx"], f32::MAX);
    bundle.change("object.json", |json| json["model_sha256"] = sha256(&network).into());
    bundle.add("keypoints.onnx", network);
    let given_up = put(&server, "cube", bundle.tar()).await;
    assert_eq!(given_up.status(), StatusCode::GATEWAY_TIMEOUT);
    let image = read(&samples()[0].file);
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    let known = answer["poses"].as_array().unwrap().iter().find(|pose| pose["status"] == "ok").unwrap();
    let request = value!({"references": [{"camera": "demo", "camera_from_object": recalibration::stated(known)}]});
    let measured = recalibration::put(&server, known["object"].as_str().unwrap(), &[image], &request).await;
    assert_eq!(measured.status(), StatusCode::OK);
}

/// The cube's net does not end for dark crops.
fn make_it_hang(models: &Path, references: &Path) {
    let path = models.join("cube/keypoints.onnx");
    let network = hanging(&std::fs::read(&path).unwrap(), 60.0);
    std::fs::write(&path, &network).unwrap();
    for (file, field) in
        [(models.join("cube/object.json"), "model_sha256"), (references.join("cube.json"), "keypoint_model_sha256")]
    {
        let mut json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
        json[field] = sha256(&network).into();
        std::fs::write(file, json.to_string()).unwrap();
    }
}

/// A keypoint net with a loop that does not end for crops that are darker in the mean, 0 to 255.
fn hanging(network: &[u8], darker_than: f32) -> Vec<u8> {
    let mut network = network.to_vec();
    // The output of the last node gets another name, of the same length.
    let output = |name: &[u8; 9]| [b"\x12\x09", &name[..]].concat();
    let at = network.windows(11).position(|window| window == output(b"keypoints")).unwrap();
    network[at..at + 11].copy_from_slice(&output(b"kp_before"));
    // Of two graphs in one message, the second continues the first.
    network.extend(bytes(7, &endless_loop(darker_than)));
    network
}

/// Nodes and constants of an ONNX graph: `keypoints` is `kp_before`, after no turns of a loop or endlessly many.
fn endless_loop(darker_than: f32) -> Vec<u8> {
    const FLOAT: u64 = 1;
    const INT64: u64 = 7;
    const BOOL: u64 = 9;
    let body = [
        bytes(1, &node("Identity", &["go_on_before"], "go_on", &[])),
        bytes(1, &node("Mul", &["before", "one"], "after", &[])),
        bytes(2, b"body"),
        bytes(11, &value("turn", INT64, true)),
        bytes(11, &value("go_on_before", BOOL, true)),
        bytes(11, &value("before", FLOAT, false)),
        bytes(12, &value("go_on", BOOL, true)),
        bytes(12, &value("after", FLOAT, false)),
    ];
    let body = [bytes(1, b"body"), bytes(6, &body.concat()), number(20, 5)].concat();
    let to_float = [bytes(1, b"to"), number(3, FLOAT), number(20, 2)].concat();
    let no_axes = [bytes(1, b"keepdims"), number(3, 0), number(20, 2)].concat();
    let nodes = [
        node("Cast", &["image"], "hang_image", &to_float),
        node("ReduceMean", &["hang_image"], "hang_mean", &no_axes),
        node("Less", &["hang_mean", "hang_limit"], "hang_dark", &[]),
        node("Where", &["hang_dark", "hang_many", "hang_once"], "hang_turns", &[]),
        node("Loop", &["hang_turns", "hang_yes", "kp_before"], "keypoints", &body),
    ];
    let constants = [
        constant("hang_limit", FLOAT, &darker_than.to_le_bytes()),
        constant("one", FLOAT, &1_f32.to_le_bytes()),
        constant("hang_many", INT64, &(1_u64 << 62).to_le_bytes()),
        constant("hang_once", INT64, &1_u64.to_le_bytes()),
        constant("hang_yes", BOOL, &[1]),
    ];
    let fields = nodes.iter().map(|node| bytes(1, node)).chain(constants.iter().map(|value| bytes(5, value)));
    fields.collect::<Vec<_>>().concat()
}

fn node(kind: &str, inputs: &[&str], output: &str, attribute: &[u8]) -> Vec<u8> {
    let inputs: Vec<u8> = inputs.iter().flat_map(|input| bytes(1, input.as_bytes())).collect();
    let attribute = if attribute.is_empty() { Vec::new() } else { bytes(5, attribute) };
    [inputs, bytes(2, output.as_bytes()), bytes(4, kind.as_bytes()), attribute].concat()
}

fn constant(name: &str, kind: u64, raw: &[u8]) -> Vec<u8> {
    [number(2, kind), bytes(8, name.as_bytes()), bytes(9, raw)].concat()
}

fn value(name: &str, kind: u64, is_scalar: bool) -> Vec<u8> {
    let shape = if is_scalar { bytes(2, b"") } else { Vec::new() };
    let tensor = [number(1, kind), shape].concat();
    [bytes(1, name.as_bytes()), bytes(2, &bytes(1, &tensor))].concat()
}

/// A protobuf field of bytes, a text, or a message.
fn bytes(field: u64, value: &[u8]) -> Vec<u8> {
    [varint(field << 3 | 2), varint(value.len() as u64), value.to_vec()].concat()
}

/// A protobuf field that is a number.
fn number(field: u64, value: u64) -> Vec<u8> {
    [varint(field << 3), varint(value)].concat()
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push((value & 0x7F) as u8 | 0x80);
        value >>= 7;
    }
    bytes.push((value & 0x7F) as u8);
    bytes
}
