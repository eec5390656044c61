//! Clients that want the server's memory: it stays under the bound that it states, and others are answered meanwhile.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use posed::proto::estimate_request::Camera;
use posed::proto::estimate_stream_request::Kind;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{EstimateRequest, EstimateStreamRequest, Frame, StreamSettings};
use reqwest::multipart::{Form, Part};
use reqwest::{Client, StatusCode};
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tonic::Code;

use crate::support::{CAMERA, Server, assert_still_works, json, png, read, samples};

const BODY: usize = 16 << 20;

#[tokio::test(flavor = "multi_thread")]
async fn hostile_clients_stay_under_the_stated_bound() {
    // A minute for each: what a slow machine can answer in less is another test's matter.
    let server = Arc::new(Server::start(&["--timeout-ms", "60000"]));
    let limits = json(reqwest::get(server.url("/v1/limits")).await.unwrap()).await;
    let bound = limits["memory"]["bound_bytes"].as_u64().unwrap();
    let good = GoodClient::start(&server);

    good.is_answered_during("uploads that stop a byte short", || uploads(&server)).await;
    good.is_answered_during("batches of large images", || batches(&server)).await;
    good.is_answered_during("forms of brackets", || brackets(&server)).await;
    good.is_answered_during("streams of large frames", || streams(&server)).await;

    let peak = peak_bytes(&server);
    println!("peak {} MiB of {} MiB", peak >> 20, bound >> 20);
    assert!(peak < bound, "{} MiB of {} MiB", peak >> 20, bound >> 20);
    good.stop().await;
    assert_still_works(&server).await;
    let status = json(reqwest::get(server.url("/v1/status")).await.unwrap()).await;
    assert_eq!((&status["queue"]["images"], &status["queue"]["body_bytes"]), (&0.into(), &0.into()));
}

/// The most that the process ever had resident.
fn peak_bytes(server: &Server) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", server.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<u64>().unwrap() * 1024
}

/// Posts a small image again and again; where there is no room it tries again a moment later, as it is told to.
struct GoodClient {
    answered: Arc<AtomicUsize>,
    stop: Arc<AtomicBool>,
    task: tokio::task::JoinHandle<()>,
}

impl GoodClient {
    fn start(server: &Arc<Server>) -> Self {
        let (answered, stop) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
        let (count, stopped, url) =
            (Arc::clone(&answered), Arc::clone(&stop), server.url(&format!("/v1/poses?{CAMERA}")));
        let task = tokio::spawn(async move {
            let (client, image) = (Client::new(), read(&samples()[0].file));
            while !stopped.load(Ordering::Relaxed) {
                let response = client.post(&url).body(image.clone()).send().await.unwrap();
                match response.status() {
                    StatusCode::OK => drop(count.fetch_add(1, Ordering::Relaxed)),
                    StatusCode::TOO_MANY_REQUESTS => tokio::time::sleep(Duration::from_millis(200)).await,
                    other => panic!("{other}: {}", response.text().await.unwrap()),
                }
            }
        });
        Self { answered, stop, task }
    }

    /// An attack that is over before a slow machine has answered anything is led again.
    async fn is_answered_during<F: Future<Output = ()>>(&self, what: &str, attack: impl Fn() -> F) {
        let before = self.answered.load(Ordering::Relaxed);
        let mut answered = 0;
        for _ in 0..10 {
            attack().await;
            answered = self.answered.load(Ordering::Relaxed) - before;
            if answered > 0 {
                break;
            }
        }
        println!("{what}: {answered} good requests answered");
        assert!(answered > 0, "no good request was answered during {what}");
        assert!(!self.task.is_finished());
    }

    async fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.task.await.unwrap();
    }
}

async fn uploads(server: &Arc<Server>) {
    let mut tasks = JoinSet::new();
    for _ in 0..64 {
        let address = server.http;
        tasks.spawn(async move {
            let mut stream = TcpStream::connect(address).await.unwrap();
            let head = format!("POST /v1/poses?{CAMERA} HTTP/1.1\r\nhost: posed\r\ncontent-length: {BODY}\r\n\r\n");
            stream.write_all(head.as_bytes()).await.unwrap();
            let block = vec![0xFF; 1 << 20];
            for part in 0..16 {
                // Refused clients are cut off.
                if stream.write_all(&block[usize::from(part == 15)..]).await.is_err() {
                    return;
                }
            }
            tokio::time::sleep(Duration::from_secs(2)).await;
        });
    }
    tasks.join_all().await;
}

async fn batches(server: &Arc<Server>) {
    let large = Bytes::from(png(&image::RgbImage::from_pixel(8192, 2929, image::Rgb([9; 3])).into()));
    let mut tasks = JoinSet::new();
    for _ in 0..16 {
        let (url, large) = (server.url("/v1/poses/batch"), large.clone());
        tasks.spawn(async move {
            let part = || Part::stream_with_length(large.clone(), large.len() as u64).file_name("large.png");
            let form = (0..16).fold(Form::new(), |form, _| form.part("image", part()));
            let form =
                form.text("request", r#"{"camera": {"model": "pinhole", "fx": 600, "fy": 600, "cx": 4e3, "cy": 1e3}}"#);
            let response = Client::new().post(url).multipart(form).send().await.unwrap();
            let status = response.status();
            assert!(status == StatusCode::OK || status == StatusCode::TOO_MANY_REQUESTS, "{status}");
        });
    }
    tasks.join_all().await;
}

async fn brackets(server: &Arc<Server>) {
    let brackets = Bytes::from(format!("{{\"camera\": [{}[]]}}", "[],".repeat(BODY / 3 - 1000)));
    let mut tasks = JoinSet::new();
    for path in ["/v1/poses", "/v1/poses/batch", "/v1/poses/batch", "/v1/poses"] {
        let (url, brackets) = (server.url(path), brackets.clone());
        tasks.spawn(async move {
            let json = Part::stream_with_length(brackets.clone(), brackets.len() as u64);
            let form = Form::new().part("image", Part::bytes(vec![0]).file_name("a")).part("request", json);
            if let Ok(response) = Client::new().post(url).multipart(form).send().await {
                // Too large, or, where a slow machine is busy for longer than they would wait, too late.
                let refused = [StatusCode::PAYLOAD_TOO_LARGE, StatusCode::TOO_MANY_REQUESTS];
                assert!(refused.contains(&response.status()), "{}", response.status());
            }
        });
    }
    tasks.join_all().await;
    tokio::time::sleep(Duration::from_secs(1)).await;
}

/// 200 streams that send faster than anybody could answer, and keep only the latest frame.
async fn streams(server: &Arc<Server>) {
    let padded = Bytes::from([read(&samples()[0].file), vec![0; 1 << 20]].concat());
    let mut tasks = JoinSet::new();
    for _ in 0..10 {
        let (address, padded) = (format!("http://{}", server.grpc), padded.clone());
        tasks.spawn(async move {
            let client = PoseServiceClient::connect(address).await.unwrap();
            let streams = (0..20).map(|_| stream(client.clone(), padded.clone()));
            futures::future::join_all(streams).await;
        });
    }
    tasks.join_all().await;
}

async fn stream(mut client: PoseServiceClient<tonic::transport::Channel>, image: Bytes) {
    let (frames, requests) = tokio::sync::mpsc::channel(1);
    let sender = tokio::spawn(async move {
        let settings = StreamSettings { latest_only: true, ..StreamSettings::default() };
        let _ = frames.send(EstimateStreamRequest { kind: Some(Kind::Settings(settings)) }).await;
        for frame_id in 0..4 {
            let camera = Some(Camera::CameraId("demo".into()));
            let request = Some(EstimateRequest { image: image.clone(), camera, ..EstimateRequest::default() });
            let _ = frames
                .send(EstimateStreamRequest {
                    kind: Some(Kind::Frame(Frame { frame_id, request, capture_time: None })),
                })
                .await;
        }
    });
    let requests = tokio_stream::wrappers::ReceiverStream::new(requests);
    match client.estimate_stream(requests).await {
        Ok(responses) => {
            let mut responses = responses.into_inner();
            // A stream that finds no room for its next frame ends with that word.
            while let Ok(Some(_)) = responses.message().await {}
        }
        Err(status) => assert_eq!(status.code(), Code::ResourceExhausted),
    }
    sender.abort();
}
