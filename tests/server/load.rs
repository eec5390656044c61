//! More than the server can take, and its end.

use std::time::Duration;

use reqwest::{Client, StatusCode};

use crate::support::{CAMERA, Server, assert_still_works, error, json, metrics, post, read, samples};

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_recovers() {
    let server = Server::start(&["--queue", "2"]);
    let image = read(&samples()[0].file);
    let requests = (0..20).map(|_| post(&server, CAMERA, image.clone()));
    let mut answered = 0;
    let mut refused = 0;
    for response in futures::future::join_all(requests).await {
        match response.status() {
            StatusCode::OK => answered += 1,
            StatusCode::TOO_MANY_REQUESTS => {
                assert_eq!(response.headers()["retry-after"], "1");
                assert_eq!(json(response).await["error"]["code"], "queue_full");
                refused += 1;
            }
            other => panic!("{other}"),
        }
    }
    assert!(answered >= 2 && refused > 0, "{answered} answered, {refused} refused");
    assert_still_works(&server).await;
}

/// A request that cannot be answered in its time is told so, and costs the next ones nothing.
#[tokio::test]
async fn a_request_has_its_time() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let url = server.url(&format!("/v1/poses?{CAMERA}"));
    let timed = async |milliseconds: &'static str| {
        let request = Client::new().post(&url).header("x-request-timeout-ms", milliseconds).body(image.clone());
        request.send().await.unwrap()
    };
    let response = timed("1").await;
    assert_eq!(response.status(), StatusCode::GATEWAY_TIMEOUT);
    assert_eq!(error(response).await.0, "timed_out");
    let response = timed("soon").await;
    assert_eq!(response.status(), StatusCode::BAD_REQUEST);
    assert!(error(response).await.1.contains("x-request-timeout-ms"));
    assert_eq!(timed("20000").await.status(), StatusCode::OK);
}

/// Images of callers that have left are not worked on.
#[tokio::test]
async fn a_caller_that_leaves_costs_no_compute() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let requests: Vec<_> = (0..12)
        .map(|_| {
            let request = Client::new().post(server.url(&format!("/v1/poses?{CAMERA}"))).body(image.clone());
            tokio::spawn(request.send())
        })
        .collect();
    // As soon as all are in the queue, everybody leaves.
    while !metrics(&server).await.contains("posed_queue_enqueued_total 12") {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    requests.iter().for_each(tokio::task::JoinHandle::abort);
    assert_still_works(&server).await;
    let text = metrics(&server).await;
    let cancelled =
        text.lines().find_map(|line| line.strip_prefix("posed_queue_dequeued_total{reason=\"cancelled\"} "));
    assert!(cancelled.unwrap().parse::<u32>().unwrap() > 0, "{text}");
    assert!(text.contains("posed_inflight 0"), "{text}");
}

#[tokio::test]
async fn a_shutdown_loses_no_accepted_request() {
    // Slow machines have their time.
    let mut server = Server::start(&["--timeout-ms", "60000", "--drain-seconds", "60"]);
    let image = read(&samples()[0].file);
    let (url, client) = (server.url(&format!("/v1/poses?{CAMERA}")), Client::new());
    let requests: Vec<_> = (0..8).map(|_| tokio::spawn(client.post(&url).body(image.clone()).send())).collect();
    // Enough for all to be accepted, not for all to be answered.
    tokio::time::sleep(Duration::from_millis(150)).await;
    server.signal("-TERM");
    for request in requests {
        assert_eq!(request.await.unwrap().unwrap().status(), StatusCode::OK);
    }
    assert!(server.wait(Duration::from_mins(1)).success());
}

/// A request that never ends holds a shutdown up, for `drain_seconds`; a second signal does not wait.
#[tokio::test]
async fn a_second_signal_ends_at_once() {
    let mut server = Server::start(&["--drain-seconds", "600"]);
    let mut unfinished = tokio::net::TcpStream::connect(server.http).await.unwrap();
    let head = format!("POST /v1/poses?{CAMERA} HTTP/1.1\r\nhost: posed\r\ncontent-length: 1000\r\n\r\nabc");
    tokio::io::AsyncWriteExt::write_all(&mut unfinished, head.as_bytes()).await.unwrap();
    tokio::time::sleep(Duration::from_millis(100)).await;
    server.signal("-TERM");
    // Draining: operators are told so, and the process is still there.
    loop {
        let response = reqwest::get(server.admin_url("/readyz")).await.unwrap();
        if response.status() == StatusCode::SERVICE_UNAVAILABLE {
            assert!(response.text().await.unwrap().contains("shutting down"));
            break;
        }
    }
    server.signal("-TERM");
    assert!(server.wait(Duration::from_secs(20)).success());
}
