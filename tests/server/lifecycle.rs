//! The server's end, and signals that are none.

use std::time::Duration;

use posed::proto::ListObjectsRequest;
use posed::proto::pose_service_client::PoseServiceClient;
use reqwest::StatusCode;
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tonic::Code;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use crate::raw_grpc::RawClient;
use crate::support::{CAMERA, Server, assert_still_works, json, post, read, samples};

/// Whoever only listens, or has not said what it wants, holds nothing up.
#[tokio::test]
async fn a_shutdown_waits_for_work_alone() {
    let mut server = Server::start(&["--drain-seconds", "600", "--idle-timeout-ms", "600000"]);
    let mut half = TcpStream::connect(server.http).await.unwrap();
    half.write_all(b"POST /v1/poses HTTP/1.1\r\nhost:").await.unwrap();
    let _silent = [TcpStream::connect(server.http).await.unwrap(), TcpStream::connect(server.grpc).await.unwrap()];
    let _without_calls = RawClient::connect(&server).await;
    let channel = Channel::from_shared(format!("http://{}", server.grpc)).unwrap().connect().await.unwrap();
    let mut health = HealthClient::new(channel);
    let mut watch = health.watch(HealthCheckRequest { service: String::new() }).await.unwrap().into_inner();
    assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
    server.signal("-TERM");
    let end = loop {
        match watch.message().await {
            Ok(Some(said)) => assert_eq!(said.status(), ServingStatus::NotServing),
            Ok(None) => panic!("the watch ended well"),
            Err(status) => break status,
        }
    };
    assert_eq!(end.code(), Code::Unavailable);
    assert!(server.wait(Duration::from_mins(1)).success());
}

/// Until a load balancer has noticed, requests still come: they are answered.
#[tokio::test]
async fn requests_are_answered_while_the_server_is_known_to_end() {
    let mut server = Server::start(&["--shutdown-delay-ms", "3000000"]);
    server.signal("-TERM");
    server.until_logged("'shutdown_delay_ms'").await;
    let ready = reqwest::get(server.admin_url("/readyz")).await.unwrap();
    assert_eq!(ready.status(), StatusCode::SERVICE_UNAVAILABLE);
    let status = json(reqwest::get(server.url("/v1/status")).await.unwrap()).await;
    assert_eq!((&status["ready"], &status["trouble"]), (&false.into(), &"shutting down".into()));
    assert_still_works(&server).await;
    let mut grpc = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    assert!(grpc.list_objects(ListObjectsRequest {}).await.is_ok());
    server.signal("-TERM");
    assert!(server.wait(Duration::from_secs(20)).success());
}

#[tokio::test]
async fn after_its_delay_the_server_ends() {
    let mut server = Server::start(&["--shutdown-delay-ms", "300"]);
    server.signal("-TERM");
    assert_eq!(post(&server, CAMERA, read(&samples()[0].file)).await.status(), StatusCode::OK);
    assert!(server.wait(Duration::from_secs(20)).success());
}

#[tokio::test]
async fn a_hangup_does_not_end_the_server() {
    let server = Server::start(&[]);
    server.signal("-HUP");
    server.until_logged("SIGHUP").await;
    assert_still_works(&server).await;
}
