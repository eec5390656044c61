//! The page without a browser: its paths and headers.

use reqwest::{Client, StatusCode};

use crate::support::{Server, assert_still_works, error};

#[tokio::test]
async fn the_page_has_strict_headers_and_is_sent_once() {
    let server = Server::start(&[]);
    let client = Client::new();
    for (path, content_type) in [
        ("/", "text/html; charset=utf-8"),
        ("/page/main.js", "text/javascript; charset=utf-8"),
        ("/page/style.css", "text/css; charset=utf-8"),
        ("/page/icon.svg", "image/svg+xml"),
        ("/page/samples/sample-1.jpg", "image/jpeg"),
        ("/page/samples/pair/pair.json", "application/json"),
    ] {
        let first = client.get(server.url(path)).send().await.unwrap();
        assert_eq!(first.status(), StatusCode::OK, "{path}");
        let header = |name: &str| first.headers()[name].to_str().unwrap().to_owned();
        assert_eq!(header("content-type"), content_type);
        let policy = header("content-security-policy");
        assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
        assert_eq!((header("x-content-type-options"), header("cache-control")), ("nosniff".into(), "no-cache".into()));
        let tag = header("etag");
        let again =
            client.get(server.url(path)).header("if-none-match", format!("\"old\", {tag}")).send().await.unwrap();
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(again.bytes().await.unwrap().len(), 0);
    }
    for path in ["/page/", "/page/nothing.js", "/page/samples/sample-9.jpg", "/page/..%2fCargo.toml"] {
        let missing = client.get(server.url(path)).send().await.unwrap();
        assert_eq!(missing.status(), StatusCode::NOT_FOUND, "{path}");
        assert_eq!(error(missing).await.0, "not_found");
    }
    let posted = client.post(server.url("/")).body("x").send().await.unwrap();
    assert_eq!(posted.status(), StatusCode::METHOD_NOT_ALLOWED);
}

#[tokio::test]
async fn it_can_be_turned_off() {
    let server = Server::start(&["--page", "false"]);
    for path in ["/", "/page/main.js", "/page/samples/sample-1.jpg"] {
        let response = reqwest::get(server.url(path)).await.unwrap();
        assert_eq!(response.status(), StatusCode::NOT_FOUND);
        assert_eq!(error(response).await.0, "not_found");
    }
    assert_still_works(&server).await;
}
