//! More connections than there are places.

use std::time::Duration;

use reqwest::StatusCode;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::raw_grpc::RawClient;
use crate::support::{Server, assert_still_works};

/// Sockets that say nothing, or half of something, far more than the process may open: others are answered meanwhile, for
/// silent ones leave their place to them.
#[tokio::test]
async fn silent_sockets_leave_their_places_to_others() {
    let server = Server::start_with_files(300, &["--idle-timeout-ms", "600000"]);
    let mut silent = Vec::new();
    for index in 0..400 {
        for address in [server.http, server.grpc] {
            let mut stream = TcpStream::connect(address).await.unwrap();
            if index % 2 == 0 {
                // It may be closed already.
                let _ = stream.write_all(b"POST /v1/poses HTTP/1.1\r\nhost:").await;
            }
            silent.push(stream);
        }
    }
    for probe in ["/livez", "/readyz"] {
        assert_eq!(reqwest::get(server.admin_url(probe)).await.unwrap().status(), StatusCode::OK);
    }
    assert_still_works(&server).await;
    assert!(RawClient::connect(&server).await.most_calls <= 1000);
    server.until_logged("'max_connections'").await;
    let log = server.log();
    assert!(log.contains("`ulimit -n`") && !log.contains("cannot accept"), "{log}");
}

/// Nobody waits for their places here: they end because their time is over.
#[tokio::test]
async fn silent_connections_end_after_their_time() {
    let server = Server::start(&["--idle-timeout-ms", "700"]);
    let hello = [b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", &[0, 0, 0, 4, 0, 0, 0, 0, 0][..]].concat();
    for (address, said) in [
        (server.http, &b""[..]),
        (server.http, b"POST /v1/poses HTTP/1.1\r\nhost:"),
        (server.http, b"GET /v1/limits HTTP/1.1\r\nhost: posed\r\n\r\n"),
        (server.grpc, b""),
        (server.grpc, b"PRI * HT"),
        // It never answers a ping.
        (server.grpc, &hello),
        (server.admin, b""),
    ] {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(said).await.unwrap();
        let ended = tokio::time::timeout(Duration::from_mins(1), stream.read_to_end(&mut Vec::new())).await;
        assert!(ended.is_ok(), "still open after {:?}", String::from_utf8_lossy(said));
    }
    assert_still_works(&server).await;
}

/// The operators' port makes room as well.
#[tokio::test]
async fn silent_sockets_do_not_keep_probes_out() {
    let server = Server::start(&["--idle-timeout-ms", "600000"]);
    let mut silent = Vec::new();
    for _ in 0..200 {
        silent.push(TcpStream::connect(server.admin).await.unwrap());
    }
    assert_eq!(reqwest::get(server.admin_url("/readyz")).await.unwrap().status(), StatusCode::OK);
}

/// `[::]` means every interface of both kinds.
#[tokio::test]
async fn both_kinds_of_addresses_are_served() {
    let server = Server::start_at("[::]:0");
    let port = server.http.port();
    let mut hosts = vec!["127.0.0.1"];
    if std::net::TcpListener::bind("[::1]:0").is_ok() {
        hosts.push("[::1]");
    }
    for host in hosts {
        let answer = reqwest::get(format!("http://{host}:{port}/v1/limits")).await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{host}");
    }
}
