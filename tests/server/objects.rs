//! `PUT` and `DELETE /v1/objects/{name}`: objects that come and go while others are served.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use reqwest::{Client, Response, StatusCode};
use serde_json::Value;
use tokio::io::AsyncWriteExt as _;

use crate::bundle::Bundle;
use crate::support::{
    CAMERA, Server, assert_right, assert_still_works, change, copy_of, error, json, post, read, refuses_to_serve,
    samples,
};

/// Folders of models and references that a server may change: all but the cube.
pub(crate) struct Folders {
    pub(crate) models: tempfile::TempDir,
    pub(crate) reference: tempfile::TempDir,
}

impl Folders {
    pub(crate) fn without_cube() -> Self {
        let (models, reference) = (copy_of("models"), copy_of("reference"));
        std::fs::remove_dir_all(models.path().join("cube")).unwrap();
        std::fs::remove_file(reference.path().join("cube.json")).unwrap();
        change(&models.path().join("detector/detector.json"), |json| json["labels"][0] = Value::Null);
        Self { models, reference }
    }

    pub(crate) fn serve(&self, more: &[&str]) -> Server {
        let folders =
            ["--models", self.models.path().to_str().unwrap(), "--reference", self.reference.path().to_str().unwrap()];
        Server::start(&[&folders[..], more].concat())
    }
}

pub(crate) async fn put(server: &Server, name: &str, bundle: Vec<u8>) -> Response {
    Client::new().put(server.url(&format!("/v1/objects/{name}"))).body(bundle).send().await.unwrap()
}

pub(crate) async fn remove(server: &Server, name: &str) -> StatusCode {
    Client::new().delete(server.url(&format!("/v1/objects/{name}"))).send().await.unwrap().status()
}

pub(crate) async fn get(server: &Server, path: &str) -> Value {
    json(reqwest::get(server.url(path)).await.unwrap()).await
}

/// Every file below a folder.
pub(crate) fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        }
        found.push(path.display().to_string());
    }
    found.sort();
    found
}

pub(crate) fn has(answer: &Value, object: &str) -> bool {
    answer["poses"].as_array().unwrap().iter().any(|pose| pose["object"] == object)
}

/// Requests one after another until told to end. All must be answered; their times, and when each began.
pub(crate) fn keep_asking(
    server: &Server,
    stop: &Arc<AtomicBool>,
) -> tokio::task::JoinHandle<Vec<(Instant, Duration)>> {
    let (url, stop, image) = (server.url(&format!("/v1/poses?{CAMERA}")), Arc::clone(stop), read(&samples()[0].file));
    tokio::spawn(async move {
        let (client, mut times) = (Client::new(), Vec::new());
        while !stop.load(Ordering::Relaxed) {
            let start = Instant::now();
            let response = client.post(&url).body(image.clone()).send().await.unwrap();
            assert_eq!(response.status(), StatusCode::OK);
            let answer = json(response).await;
            assert!(has(&answer, "motor"), "{answer}");
            times.push((start, start.elapsed()));
        }
        times
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn an_object_comes_and_goes_while_others_are_served() {
    let folders = Folders::without_cube();
    let server = folders.serve(&["--object-changes"]);
    let sample = &samples()[0];
    let image = read(&sample.file);
    assert_eq!(post(&server, &format!("{CAMERA}&objects=cube"), image.clone()).await.status(), StatusCode::NOT_FOUND);
    let limits = get(&server, "/v1/limits").await;
    assert!(limits["object_changes"] == true && limits["memory"]["object_changes_bytes"].as_u64().unwrap() > 0);

    let stop = Arc::new(AtomicBool::new(false));
    let asking = [keep_asking(&server, &stop), keep_asking(&server, &stop)];
    let response = put(&server, "cube", Bundle::of("cube").tar()).await;
    assert_eq!(response.status(), StatusCode::OK);
    let object = json(response).await;
    assert!(
        object["name"] == "cube" && object["calibrated"] == true && object["detector_sha256"].is_string(),
        "{object}"
    );
    // At once: no image that comes after the answer is worked on without it.
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    assert_right(sample, &answer);
    assert!(answer["models"]["own_detectors"]["cube"].is_string() && answer["models"]["keypoints"]["cube"].is_string());
    let shown = reqwest::get(server.url("/v1/objects/cube/reference/cube.jpg")).await.unwrap();
    assert_eq!((shown.status(), &shown.headers()["content-type"]), (StatusCode::OK, &"image/jpeg".parse().unwrap()));
    assert!(crate::support::metrics(&server).await.contains("model=\"cube/detector\""));

    // Another one in its place, and away.
    assert_eq!(put(&server, "cube", Bundle::of("cube").tar()).await.status(), StatusCode::OK);
    assert_eq!(remove(&server, "link").await, StatusCode::NO_CONTENT);
    stop.store(true, Ordering::Relaxed);
    for asking in asking {
        assert!(!asking.await.unwrap().is_empty());
    }
    assert_eq!(remove(&server, "link").await, StatusCode::NOT_FOUND);
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    assert!(has(&answer, "cube") && !has(&answer, "link"), "{answer}");
    assert!(!folders.models.path().join("link").exists());
    assert!(files(folders.models.path()).iter().all(|file| !file.contains("incoming")));
    drop(server);

    let restarted = folders.serve(&[]);
    let answer = json(post(&restarted, CAMERA, image).await).await;
    assert!(has(&answer, "cube") && has(&answer, "motor") && !has(&answer, "link"), "{answer}");
}

#[tokio::test]
async fn changes_of_objects_are_off_unless_allowed() {
    let folders = Folders::without_cube();
    let tokens = folders.models.path().join("tokens");
    let line = |token: &str, scopes: &str| format!("{} {scopes}\n", crate::bundle::sha256(token.as_bytes()));
    std::fs::write(&tokens, line("robot", "estimate,calibrate") + &line("cell", "objects")).unwrap();
    let server = folders.serve(&[]);
    let refused = put(&server, "cube", Bundle::of("cube").tar()).await;
    assert_eq!(refused.status(), StatusCode::FORBIDDEN);
    let (code, message) = error(refused).await;
    assert!(code == "forbidden" && message.contains("'object_changes'") && message.contains("--object-changes"));
    assert_eq!(remove(&server, "motor").await, StatusCode::FORBIDDEN);
    drop(server);

    let server =
        folders.serve(&["--object-changes", "--tokens", tokens.to_str().unwrap(), "--max-bundle-bytes", "1000000"]);
    let request =
        |token: &str| Client::new().delete(server.url("/v1/objects/nothing")).bearer_auth(token.to_owned()).send();
    assert_eq!(request("guess").await.unwrap().status(), StatusCode::UNAUTHORIZED);
    assert_eq!(request("robot").await.unwrap().status(), StatusCode::FORBIDDEN);
    assert_eq!(request("cell").await.unwrap().status(), StatusCode::NOT_FOUND);
    let url = server.url("/v1/objects/cube");
    for chunked in [false, true] {
        // Little enough that all of it is read, whoever is faster.
        let bytes = Bundle::of("cube").tar()[..1_200_000].to_vec();
        let body = if chunked {
            reqwest::Body::wrap_stream(futures::stream::iter(
                bytes.chunks(65536).map(|c| Ok::<_, std::io::Error>(c.to_vec())).collect::<Vec<_>>(),
            ))
        } else {
            bytes.into()
        };
        let refused = Client::new().put(&url).bearer_auth("cell").body(body).send().await.unwrap();
        assert_eq!(refused.status(), StatusCode::PAYLOAD_TOO_LARGE);
        assert!(error(refused).await.1.contains("1000000 bytes ('max_bundle_bytes')"));
    }
    drop(server);
    let nowhere = folders.models.path().join("tokens/models");
    refuses_to_serve(&["--models", nowhere.to_str().unwrap(), "--object-changes"], "cannot write to the models folder");
}

/// Another frame in the bundle's reference counts, unless somebody has calibrated the object here.
#[tokio::test]
async fn a_calibration_that_was_made_here_outlives_a_new_bundle() {
    let folders = Folders::without_cube();
    let server = folders.serve(&["--object-changes", "--recalibration"]);
    let mut moved = Bundle::of("cube");
    moved.change("reference.json", |json| {
        let x = json["object_from_keypoints"]["translation_m"][0].as_f64().unwrap();
        json["object_from_keypoints"]["translation_m"][0] = (x + 0.01).into();
    });
    let hash = async || get(&server, "/v1/objects/cube").await["reference"]["sha256"].clone();
    assert_eq!(put(&server, "cube", Bundle::of("cube").tar()).await.status(), StatusCode::OK);
    let first = hash().await;
    assert_eq!(put(&server, "cube", moved.tar()).await.status(), StatusCode::OK);
    assert_ne!(hash().await, first);
    let shipped = read(&crate::support::root().join("reference/cube.json"));
    std::fs::write(folders.reference.path().join("cube.json"), &shipped).unwrap();
    server.until_logged("cube has a new reference").await;
    assert_eq!(hash().await, first);
    assert_eq!(put(&server, "cube", moved.tar()).await.status(), StatusCode::OK);
    assert_eq!(hash().await, first);
    // One of another network is passed over.
    change(&folders.reference.path().join("cube.json"), |json| json["keypoint_model_sha256"] = "0".repeat(64).into());
    assert_eq!(put(&server, "cube", moved.tar()).await.status(), StatusCode::OK);
    assert_ne!(hash().await, first);
    assert_eq!(get(&server, "/v1/objects/cube").await["calibrated"], true);
}

/// Whoever leaves half way leaves nothing behind, and the next one has the turn.
#[tokio::test]
async fn an_upload_that_ends_early_leaves_nothing() {
    let folders = Folders::without_cube();
    let server = folders.serve(&["--object-changes", "--body-timeout-ms", "2000"]);
    let before = files(folders.models.path());
    let bundle = Bundle::of("cube").tar();
    let head = |length: usize| format!("PUT /v1/objects/cube HTTP/1.1\r\nhost: x\r\ncontent-length: {length}\r\n\r\n");
    let begin = async || {
        let mut stream = tokio::net::TcpStream::connect(server.http).await.unwrap();
        stream.write_all(head(bundle.len()).as_bytes()).await.unwrap();
        stream.write_all(&bundle[..1_000_000]).await.unwrap();
        stream
    };
    // What others are told meanwhile, and afterwards. They come later, else it is they who have the turn.
    let until = async |status: StatusCode| loop {
        tokio::time::sleep(Duration::from_millis(200)).await;
        if put(&server, "cube", bundle[..2000].to_vec()).await.status() == status {
            break;
        }
    };
    let stream = begin().await;
    until(StatusCode::TOO_MANY_REQUESTS).await;
    drop(stream);
    until(StatusCode::UNPROCESSABLE_ENTITY).await;
    // A client that stalls is cut off.
    let stalled = begin().await;
    until(StatusCode::TOO_MANY_REQUESTS).await;
    until(StatusCode::UNPROCESSABLE_ENTITY).await;
    drop(stalled);
    assert_eq!(files(folders.models.path()), before);
    assert_eq!(put(&server, "cube", bundle.clone()).await.status(), StatusCode::OK);
    assert_still_works(&server).await;
}

/// `--watch`: what is copied into the folder, replaced or removed there is served within seconds; what is broken is not.
#[tokio::test]
async fn a_watched_folder_is_served_as_it_changes() {
    let folders = Folders::without_cube();
    let server = folders.serve(&["--watch"]);
    let image = read(&samples()[0].file);
    let cube = folders.models.path().join("cube");
    Bundle::of("cube").write(&cube);
    server.until_logged("cube was added").await;
    let answer = json(post(&server, CAMERA, image.clone()).await).await;
    assert_right(&samples()[0], &answer);

    change(&cube.join("object.json"), |json| json["diameter_m"] = 77.into());
    server.until_logged("cube changed in the models folder, but cannot be served").await;
    assert_eq!(
        get(&server, "/v1/objects/cube").await["diameter_m"],
        get(&Server::start(&[]), "/v1/objects/cube").await["diameter_m"]
    );
    assert_right(&samples()[0], &json(post(&server, CAMERA, image.clone()).await).await);
    change(&cube.join("object.json"), |json| json["diameter_m"] = 0.1.into());
    server.until_logged("cube was replaced").await;
    assert_eq!(get(&server, "/v1/objects/cube").await["diameter_m"], 0.1);

    // The detector that all share: it knows the motor no longer.
    change(&folders.models.path().join("detector/detector.json"), |json| {
        for label in json["labels"].as_array_mut().unwrap().iter_mut().filter(|label| *label == "motor") {
            *label = Value::Null;
        }
    });
    server.until_logged("the shared detector was changed").await;
    server.until_logged("motor: not in the detector's labels").await;
    std::fs::remove_dir_all(&cube).unwrap();
    server.until_logged("cube was removed").await;
    let answer = json(post(&server, CAMERA, image).await).await;
    assert!(!has(&answer, "cube") && !has(&answer, "motor") && has(&answer, "link"), "{answer}");
}

/// A server that begins with nothing.
#[tokio::test]
async fn an_empty_server_is_filled() {
    let (models, reference) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (models, reference) = (models.path().to_str().unwrap(), reference.path().to_str().unwrap());
    refuses_to_serve(&["--models", models, "--reference", reference], "has no object");
    let server = Server::start(&["--models", models, "--reference", reference, "--object-changes"]);
    assert_eq!(reqwest::get(server.admin_url("/readyz")).await.unwrap().status(), StatusCode::OK);
    let image = read(&samples()[0].file);
    assert!(!has(&json(post(&server, CAMERA, image.clone()).await).await, "cube"));
    assert_eq!(put(&server, "cube", Bundle::of("cube").tar()).await.status(), StatusCode::OK);
    assert!(has(&json(post(&server, CAMERA, image).await).await, "cube"));
    assert_eq!(remove(&server, "cube").await, StatusCode::NO_CONTENT);
}
