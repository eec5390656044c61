//! A server that wants tokens.

use sha2::{Digest as _, Sha256};

use crate::browser::Browser;
use crate::support::Server;

#[tokio::test]
async fn the_page_asks_for_a_token_where_the_server_does() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let hash = Sha256::digest("robot").iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}"));
    std::fs::write(&file, format!("{hash} estimate\n")).unwrap();
    let (server, browser) = (Server::start(&["--tokens", file.to_str().unwrap()]), Browser::start().await);
    browser.open(&server.url("/")).await;
    browser.until("!document.querySelector('#token').hidden").await;
    browser.until_text("#try-problem", "this server needs a token").await;
    browser.fill("This server wants a token", "guess").await;
    browser.press("Use it").await;
    browser.until_text("#try-problem", "the token is not known").await;
    browser.fill("This server wants a token", "robot").await;
    browser.press("Use it").await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    browser.click(".thumbnail").await;
    assert_eq!(browser.poses().await.len(), 4);
    assert_eq!(browser.text("#try-problem").await, "");
}
