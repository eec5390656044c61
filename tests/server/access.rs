//! Bearer tokens and TLS.

use std::path::Path;
use std::sync::Arc;

use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{EstimateRequest, ListObjectsRequest};
use reqwest::{Client, Method, RequestBuilder, StatusCode};
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use tonic::{Code, Request};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use crate::raw_grpc::RawClient;
use crate::support::{CAMERA, Server, error, posed, read, refuses_to_serve, samples};

fn line(token: &str, scopes: &str) -> String {
    let hash = Sha256::digest(token).iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}"));
    format!("{hash} {scopes}\n")
}

#[tokio::test]
async fn tokens_say_who_may_do_what_and_are_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let robot = line("robot", "estimate # cell 3");
    std::fs::write(&file, format!("# who\n\n{robot}{}", line("boss", "calibrate, admin"))).unwrap();
    let server = Server::start(&["--tokens", file.to_str().unwrap(), "--recalibration"]);
    let with = |request: RequestBuilder, token: Option<&str>| {
        let request = token.map(|token| request.try_clone().unwrap().bearer_auth(token)).unwrap_or(request);
        async move { request.send().await.unwrap() }
    };
    let poses = || Client::new().post(server.url(&format!("/v1/poses?{CAMERA}"))).body(read(&samples()[0].file));
    let reference = || Client::new().put(server.url("/v1/objects/cube/reference")).body("no form");
    let objects = || Client::new().get(server.url("/v1/objects"));
    let metrics = || Client::new().get(server.admin_url("/metrics"));
    let log_level = || Client::new().request(Method::PUT, server.admin_url("/log-level")).body("info");
    let stranger = with(poses(), None).await;
    assert_eq!(
        (stranger.status(), &stranger.headers()["www-authenticate"]),
        (StatusCode::UNAUTHORIZED, &"Bearer".parse().unwrap())
    );
    assert_eq!(error(stranger).await.0, "unauthenticated");
    for (request, token, status) in [
        (poses(), Some("guess"), StatusCode::UNAUTHORIZED),
        (poses(), Some("boss"), StatusCode::FORBIDDEN),
        (poses(), Some("robot"), StatusCode::OK),
        (reference(), Some("robot"), StatusCode::FORBIDDEN),
        (reference(), Some("boss"), StatusCode::UNSUPPORTED_MEDIA_TYPE),
        (objects(), None, StatusCode::UNAUTHORIZED),
        (objects(), Some("robot"), StatusCode::OK),
        (metrics(), None, StatusCode::UNAUTHORIZED),
        (metrics(), Some("robot"), StatusCode::FORBIDDEN),
        (metrics(), Some("boss"), StatusCode::OK),
        (log_level(), Some("robot"), StatusCode::FORBIDDEN),
        (log_level(), Some("boss"), StatusCode::OK),
    ] {
        let asked = format!("{request:?}");
        assert_eq!(with(request, token).await.status(), status, "{asked} with {token:?}");
    }
    assert!(posed(&["healthcheck", "--admin", &server.admin.to_string()]).output().unwrap().status.success());
    over_grpc(&server).await;

    // A file with a fault changes nothing; a good one counts at once.
    std::fs::write(&file, "robot estimate\n").unwrap();
    server.signal("-HUP");
    server.until_logged("the old tokens stay in force").await;
    assert_eq!(with(objects(), Some("robot")).await.status(), StatusCode::OK);
    std::fs::write(&file, line("other", "estimate")).unwrap();
    server.signal("-HUP");
    server.until_logged("1 tokens are in force").await;
    assert_eq!(with(objects(), Some("robot")).await.status(), StatusCode::UNAUTHORIZED);
    assert_eq!(with(objects(), Some("other")).await.status(), StatusCode::OK);
}

async fn over_grpc(server: &Server) {
    fn with<T>(message: T, token: &str) -> Request<T> {
        let mut request = Request::new(message);
        request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
        request
    }
    let mut client = PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap();
    let code = client.list_objects(ListObjectsRequest {}).await.unwrap_err().code();
    assert_eq!(code, Code::Unauthenticated);
    assert!(client.list_objects(with(ListObjectsRequest {}, "boss")).await.is_ok());
    let refused = client.estimate(with(EstimateRequest::default(), "boss")).await.unwrap_err();
    assert_eq!(refused.code(), Code::PermissionDenied);
    let refused = client.estimate(with(EstimateRequest::default(), "robot")).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    let channel = tonic::transport::Channel::from_shared(format!("http://{}", server.grpc)).unwrap();
    let mut health = HealthClient::new(channel.connect().await.unwrap());
    assert!(health.check(HealthCheckRequest { service: String::new() }).await.is_ok());
    let metrics = Client::new().get(server.admin_url("/metrics")).bearer_auth("boss").send().await.unwrap();
    let counted = "route=\"ListObjects\",outcome=\"unauthenticated\"} 1";
    assert!(metrics.text().await.unwrap().contains(counted));
}

#[test]
fn a_file_of_tokens_that_cannot_be_used_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let good = line("robot", "estimate");
    for (text, words) in [
        ("# nobody\n".to_owned(), "no token"),
        (format!("{good}robot estimate\n"), "line 2: it does not begin with 64 hexadecimal digits"),
        (line("robot", "fly"), "line 1: unknown scope \"fly\""),
        (good[..64].to_owned(), "line 1: it has no scopes"),
    ] {
        std::fs::write(&file, text).unwrap();
        refuses_to_serve(&["--tokens", file.to_str().unwrap()], words);
    }
    refuses_to_serve(&["--tokens", "nowhere"], "cannot read the tokens nowhere");
}

/// A certificate for 'localhost', written beside its key.
fn certificate(folder: &Path) -> CertificateDer<'static> {
    let made = rcgen::generate_simple_self_signed(vec!["localhost".into()]).unwrap();
    std::fs::write(folder.join("certificate.pem"), made.cert.pem()).unwrap();
    std::fs::write(folder.join("key.pem"), made.signing_key.serialize_pem()).unwrap();
    made.cert.der().clone()
}

/// Connects, and trusts no other certificate.
async fn connect(
    address: std::net::SocketAddr,
    trusted: &CertificateDer<'static>,
    protocol: &str,
) -> std::io::Result<TlsStream<tokio::net::TcpStream>> {
    let mut roots = RootCertStore::empty();
    roots.add(trusted.clone()).unwrap();
    let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let builder = builder.with_safe_default_protocol_versions().unwrap();
    let mut config = builder.with_root_certificates(roots).with_no_client_auth();
    config.alpn_protocols = vec![protocol.into()];
    let stream = tokio::net::TcpStream::connect(address).await.unwrap();
    TlsConnector::from(Arc::new(config)).connect("localhost".try_into().unwrap(), stream).await
}

#[tokio::test]
async fn both_ports_speak_tls_and_a_new_certificate_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let first = certificate(folder.path());
    let [chain, key] = ["certificate.pem", "key.pem"].map(|name| folder.path().join(name).display().to_string());
    let server = Server::start(&["--tls-certificate", &chain, "--tls-key", &key, "--idle-timeout-ms", "2000"]);
    let ask = async |trusted: &CertificateDer<'static>| {
        let mut stream = connect(server.http, trusted, "http/1.1").await?;
        let head = "GET /v1/limits HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
        stream.write_all(head.as_bytes()).await?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.map(|_| answer)
    };
    let answer = ask(&first).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("max_body_bytes"), "{answer}");
    let mut client = RawClient::over(connect(server.grpc, &first, "h2").await.unwrap()).await;
    let mut call = client.call("ListObjects", &[]).await;
    call.send(b"", true);
    let (_, mut body) = call.answer().await.into_parts();
    assert!(body.data().await.unwrap().unwrap().len() > 5);
    // Whoever does not speak it gets nothing, and does not hold its place.
    assert!(reqwest::get(server.url("/v1/limits")).await.is_err());
    let mut silent = tokio::net::TcpStream::connect(server.http).await.unwrap();
    assert_eq!(silent.read(&mut [0]).await.unwrap_or(0), 0);

    let second = certificate(folder.path());
    server.signal("-HUP");
    server.until_logged("the certificate is read again").await;
    assert!(ask(&second).await.is_ok() && ask(&first).await.is_err());
    std::fs::write(folder.path().join("key.pem"), "no key").unwrap();
    server.signal("-HUP");
    server.until_logged("the old certificate stays in force").await;
    assert!(ask(&second).await.is_ok());
    refuses_to_serve(&["--tls-certificate", &chain, "--tls-key", &key], "key.pem has no usable private key");
    certificate(folder.path());
    std::fs::write(&chain, second_pem(folder.path())).unwrap();
    refuses_to_serve(&["--tls-certificate", &chain, "--tls-key", &key], "cannot be used together");
}

/// The certificate of another key.
fn second_pem(folder: &Path) -> Vec<u8> {
    let other = tempfile::tempdir_in(folder).unwrap();
    certificate(other.path());
    read(&other.path().join("certificate.pem"))
}
