//! Every request is counted once, with what became of it, and has a line in the log.

use std::io::Write as _;
use std::net::TcpStream;
use std::time::Duration;

use posed::proto::EstimateRequest;
use posed::proto::estimate_request::Camera;
use posed::proto::pose_service_client::PoseServiceClient;
use reqwest::Client;
use serde_json::Value;
use socket2::SockRef;

use crate::raw_grpc::RawClient;
use crate::support::{CAMERA, Server, error, metrics, png, post, read, samples};

#[tokio::test]
async fn callers_that_vanish_are_counted() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let (url, client) = (server.url(&format!("/v1/poses?{CAMERA}")), Client::new());
    let http: Vec<_> = (0..6).map(|_| tokio::spawn(client.post(&url).body(image.clone()).send())).collect();
    let grpc: Vec<_> = (0..6)
        .map(|_| {
            let (address, image) = (format!("http://{}", server.grpc), image.clone().into());
            let request =
                EstimateRequest { image, camera: Some(Camera::CameraId("demo".into())), ..Default::default() };
            tokio::spawn(async move { PoseServiceClient::connect(address).await.unwrap().estimate(request).await })
        })
        .collect();
    server.until_counted("posed_queue_enqueued_total 12").await;
    http.iter().for_each(tokio::task::JoinHandle::abort);
    grpc.iter().for_each(tokio::task::JoinHandle::abort);
    for route in ["protocol=\"http\",route=\"/v1/poses\"", "protocol=\"grpc\",route=\"Estimate\""] {
        server.until_counted(&format!("posed_requests_total{{{route},outcome=\"cancelled\"}}")).await;
    }
    server.until_counted("posed_inflight 0").await;
    let text = metrics(&server).await;
    let all = text.lines().filter(|line| line.starts_with("posed_requests_total{"));
    let sum: u32 = all.map(|line| line.split_once("} ").unwrap().1.parse::<u32>().unwrap()).sum();
    assert_eq!(sum, 12, "{text}");
}

/// They leave half a body behind, whose end nobody will see.
#[tokio::test]
async fn callers_that_vanish_while_they_send_are_counted() {
    let server = Server::start(&[]);
    for linger in [None, Some(Duration::ZERO)] {
        let stream = TcpStream::connect(server.http).unwrap();
        let head = format!(
            "POST /v1/poses?{CAMERA} HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\nContent-Length: 24000\r\n\r\n"
        );
        (&stream).write_all(&[head.as_bytes(), &[0; 1000]].concat()).unwrap();
        std::thread::sleep(Duration::from_millis(200));
        // Without lingering the end is a reset.
        SockRef::from(&stream).set_linger(linger).unwrap();
        drop(stream);
    }
    server.until_counted("posed_requests_total{protocol=\"http\",route=\"/v1/poses\",outcome=\"cancelled\"} 2").await;
    let mut client = RawClient::connect(&server).await;
    let mut call = client.call("Estimate", &[]).await;
    // Of sixteen bytes.
    call.upload.send_data(b"\0\0\0\0\x10half"[..].into(), true).unwrap();
    assert_eq!(call.refused().await.0, "13");
    server.until_counted("posed_requests_total{protocol=\"grpc\",route=\"Estimate\",outcome=\"cancelled\"} 1").await;
}

/// What goes into the queue comes out of it, also where the image is not the camera's.
#[tokio::test]
async fn images_of_another_size_leave_the_queue() {
    let server = Server::start(&[]);
    let small = png(&image::RgbImage::new(320, 240).into());
    for _ in 0..3 {
        assert_eq!(post(&server, "camera=demo", small.clone()).await.status(), 400);
    }
    server.until_counted("posed_queue_enqueued_total 3").await;
    server.until_counted("posed_queue_dequeued_total{reason=\"worked\"} 3").await;
}

#[tokio::test]
async fn what_no_handler_sees_is_counted_too() {
    let server = Server::start(&[]);
    let response = reqwest::get(server.url("/v1/objects/%FF")).await.unwrap();
    assert_eq!(response.status(), 400);
    assert_eq!(error(response).await.0, "invalid_request");
    let mut client = RawClient::connect(&server).await;
    let mut call = client.call("Estimate", &[]).await;
    call.send(b"\x0a\xff no message", true);
    let (code, answer) = call.refused().await;
    assert_eq!(code, "3");
    assert_eq!(answer.headers()["x-request-id"].len(), 36);
    let mut call = client.call("Estimate", &[("grpc-timeout", "soon"), ("x-request-id", "frame-17")]).await;
    call.send(b"", true);
    let (code, answer) = call.refused().await;
    assert_eq!((code.as_str(), answer.headers()["x-request-id"].to_str().unwrap()), ("3", "frame-17"));
    let mut call = client.call("Guess", &[]).await;
    call.send(b"", true);
    assert_eq!(call.refused().await.0, "12");
    for counted in [
        "protocol=\"http\",route=\"/v1/objects/{name}\",outcome=\"invalid_request\"} 1",
        "protocol=\"grpc\",route=\"Estimate\",outcome=\"invalid_request\"} 2",
        "protocol=\"grpc\",route=\"other\",outcome=\"not_found\"} 1",
    ] {
        server.until_counted(counted).await;
    }
}

/// Open calls are bounded, on one connection and on all; those beyond are refused, and counted like all others.
#[tokio::test]
async fn calls_beyond_the_limit_are_refused_and_counted() {
    let server = Server::start(&[]);
    let mut clients = Vec::new();
    let mut open = Vec::new();
    let refused = loop {
        let mut client = RawClient::connect(&server).await;
        for _ in 1..client.most_calls {
            open.push(client.call("EstimateStream", &[]).await);
        }
        // Refused calls are answered at once, others not before their first message.
        let mut call = client.call("ListObjects", &[]).await;
        call.send(b"", true);
        let answer = call.answer().await;
        clients.push(client);
        if let Some(code) = answer.headers().get("grpc-status") {
            break code.to_str().unwrap().to_owned();
        }
        assert!(clients.len() < 100, "there is no limit");
    };
    assert_eq!(refused, "8");
    let counted = "protocol=\"grpc\",route=\"ListObjects\",outcome=\"queue_full\"} 1";
    server.until_counted(counted).await;
    drop((open, clients));
    assert_eq!(post(&server, CAMERA, read(&samples()[0].file)).await.status(), 200);
}

/// Whatever clients send: lines are short, and numbers are numbers.
#[tokio::test]
async fn lines_of_the_log_are_short_and_typed() {
    let server = Server::start(&["--log-format", "json", "--log", "debug"]);
    let long = "x".repeat(20_000);
    let method = reqwest::Method::from_bytes(long.as_bytes()).unwrap();
    let _ = Client::new().request(method, server.url("/v1/limits")).send().await.unwrap();
    post(&server, &format!("camera={long}"), b"no image".to_vec()).await;
    post(&server, CAMERA, b"no image".to_vec()).await;
    server.until_logged("unsupported_format").await;
    let log = server.log();
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let longest = log.lines().map(str::len).max().unwrap();
    assert!(longest < 4096, "{longest} bytes");
    let answered: Vec<&Value> = lines.iter().filter(|line| line["outcome"].is_string()).collect();
    assert_eq!(answered.len(), 3, "{log}");
    assert!(answered.iter().all(|line| line["status"].is_u64() && line["ms"].is_u64()), "{log}");
}
