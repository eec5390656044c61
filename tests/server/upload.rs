//! Bodies that lie about their length, come slowly, or find no room.

use std::time::{Duration, Instant};

use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{EstimateRequest, ListObjectsRequest};
use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tonic::Code;
use tonic_types::StatusExt as _;

use crate::support::{CAMERA, Server, assert_still_works, json, post, read, samples};

/// Room for two large bodies, and a short patience.
const TIGHT: [&str; 6] = ["--max-body-bytes", "2000000", "--queue-bytes", "4600000", "--body-timeout-ms", "700"];

async fn send(server: &Server, head: &str, body: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(server.http).await.unwrap();
    let head = format!("POST /v1/poses?{CAMERA} HTTP/1.1\r\nhost: posed\r\n{head}\r\n\r\n");
    stream.write_all(head.as_bytes()).await.unwrap();
    // A server that has had enough may close the connection meanwhile.
    let _ = stream.write_all(body).await;
    stream
}

/// All that the server says until it closes the connection.
async fn rest(mut stream: TcpStream) -> String {
    let mut answer = Vec::new();
    let _ = tokio::time::timeout(Duration::from_secs(20), stream.read_to_end(&mut answer)).await.unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

async fn status(server: &Server) -> Value {
    json(reqwest::get(server.url("/v1/status")).await.unwrap()).await
}

async fn until_held(server: &Server, held: impl Fn(u64) -> bool) {
    let start = Instant::now();
    loop {
        let bytes = status(server).await["queue"]["body_bytes"].as_u64().unwrap();
        if held(bytes) {
            return;
        }
        assert!(start.elapsed() < Duration::from_secs(20), "{bytes} bytes are held");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Two clients announce large bodies and stall: a third hears at once that there is no room, before it sends anything; a
/// small image is answered meanwhile; and when the two are cut off their room is free again.
#[tokio::test]
async fn what_finds_no_room_is_refused_before_its_upload() {
    let server = Server::start(&TIGHT);
    let stalled = [
        send(&server, "content-length: 2000000", b"\xFF\xD8 the first bytes").await,
        send(&server, "content-length: 2000000", b"").await,
    ];
    until_held(&server, |bytes| bytes == 4_000_000).await;
    let refused = rest(send(&server, "content-length: 1900000\r\nexpect: 100-continue", b"").await).await;
    assert!(refused.starts_with("HTTP/1.1 429") && refused.contains("'queue_bytes'"), "{refused}");
    assert!(refused.contains("retry-after: 1") && refused.contains("connection: close"), "{refused}");
    // Whoever sends first and reads later comes to read the answer, too.
    let simple = rest(send(&server, "content-length: 1900000", &vec![0; 1_900_000]).await).await;
    assert!(simple.starts_with("HTTP/1.1 429"), "{simple}");
    let mut grpc = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let large = EstimateRequest { image: vec![0; 1_900_000].into(), ..EstimateRequest::default() };
    let status = grpc.estimate(large).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().is_some(), "{status}");
    let metrics = reqwest::get(server.admin_url("/metrics")).await.unwrap().text().await.unwrap();
    let counted = "posed_requests_total{protocol=\"grpc\",route=\"Estimate\",outcome=\"queue_full\"} 1";
    assert!(metrics.contains(counted), "{metrics}");
    assert_still_works(&server).await;
    for stream in stalled {
        let answer = rest(stream).await;
        assert!(answer.starts_with("HTTP/1.1 504") && answer.contains("'body_timeout_ms'"), "{answer}");
    }
    until_held(&server, |bytes| bytes == 0).await;
    let large = [read(&samples()[0].file), vec![0; 1_900_000]].concat();
    assert_eq!(post(&server, CAMERA, large).await.status(), 200);
}

#[tokio::test]
async fn a_length_that_lies_harms_only_its_own_request() {
    let server = Server::start(&TIGHT);
    let image = read(&samples()[0].file);
    // Longer than what comes: the client leaves.
    let longer = send(&server, &format!("content-length: {}", image.len() + 1000), &image).await;
    until_held(&server, |bytes| bytes > 0).await;
    drop(longer);
    until_held(&server, |bytes| bytes == 0).await;
    // Shorter: the image is cut, and what follows is no request.
    let shorter = rest(send(&server, &format!("content-length: {}", image.len() / 2), &image).await).await;
    assert!(shorter.starts_with("HTTP/1.1 400") && shorter.contains("truncated"), "{shorter}");
    // Absent: there is no body.
    let absent = rest(send(&server, "connection: close", b"").await).await;
    assert!(absent.starts_with("HTTP/1.1 400") && absent.contains("empty"), "{absent}");
    // No number, and one beyond all limits.
    let word = rest(send(&server, "content-length: many", b"").await).await;
    assert!(word.starts_with("HTTP/1.1 400"), "{word}");
    let huge = rest(send(&server, "content-length: 99999999999\r\nexpect: 100-continue", b"").await).await;
    assert!(huge.starts_with("HTTP/1.1 413") && huge.contains("'max_body_bytes'"), "{huge}");
    assert_still_works(&server).await;
}

/// Without a length the room grows with what comes.
#[tokio::test]
async fn chunks_are_counted_as_they_come() {
    let server = Server::start(&TIGHT);
    let chunked = |bytes: &[u8]| {
        let chunks =
            bytes.chunks(60_000).map(|chunk| [format!("{:x}\r\n", chunk.len()).as_bytes(), chunk, b"\r\n"].concat());
        chunks.collect::<Vec<_>>().concat()
    };
    let head = "transfer-encoding: chunked\r\nconnection: close";
    let whole = [chunked(&read(&samples()[0].file)), b"0\r\n\r\n".to_vec()].concat();
    let answer = rest(send(&server, head, &whole).await).await;
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let open = send(&server, head, &chunked(&vec![1; 500_000])).await;
    until_held(&server, |bytes| bytes == 500_000).await;
    let endless = rest(send(&server, head, &chunked(&vec![1; 2_100_000])).await).await;
    assert!(endless.starts_with("HTTP/1.1 413"), "{endless}");
    let broken = rest(send(&server, head, b"zz\r\nno chunk\r\n").await).await;
    assert!(broken.starts_with("HTTP/1.1 400"), "{broken}");
    assert!(rest(open).await.starts_with("HTTP/1.1 504"));
    until_held(&server, |bytes| bytes == 0).await;
    assert_still_works(&server).await;
}

/// A connection that asks nothing is closed after its time, so that it takes no other's place.
#[tokio::test]
async fn silent_connections_make_room() {
    let server = Server::start(&["--max-connections", "8", "--idle-timeout-ms", "1500"]);
    let mut silent = Vec::new();
    for _ in 0..20 {
        silent.push(TcpStream::connect(server.http).await.unwrap());
        silent.push(TcpStream::connect(server.grpc).await.unwrap());
    }
    let mut half = TcpStream::connect(server.http).await.unwrap();
    half.write_all(b"POST /v1/poses HTTP/1.1\r\nhost:").await.unwrap();
    // Operators have a port of their own.
    assert_eq!(reqwest::get(server.admin_url("/readyz")).await.unwrap().status(), 200);
    assert_still_works(&server).await;
    let mut grpc = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    assert!(!grpc.list_objects(ListObjectsRequest {}).await.unwrap().into_inner().objects.is_empty());
    assert!(!rest(half).await.contains("200"));
}
