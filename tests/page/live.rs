//! Live mode, with a film in place of a camera.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::browser::Browser;
use crate::support::{CAMERA, Server, post, read, samples};
use crate::video;

const FIGURES: &str = "/[0-9.]+ images\\/s, [0-9]+ ms/.test(document.querySelector('#try-figures').innerText)";

/// A browser whose camera shows the first sample.
async fn with_camera(folder: &tempfile::TempDir) -> Browser {
    let film = folder.path().join("film.y4m");
    video::write(&film, &image::open(&samples()[0].file).unwrap().into_rgb8());
    Browser::with(&[format!("--use-file-for-fake-video-capture={}", film.display())]).await
}

async fn go_live(browser: &Browser, server: &Server) {
    browser.open(&server.url("/")).await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    browser.press("Live").await;
    browser.until(FIGURES).await;
}

#[tokio::test]
async fn frames_are_answered_and_a_server_that_is_gone_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let (server, browser) = (Server::start(&[]), with_camera(&folder).await);
    go_live(&browser, &server).await;
    let sample = &samples()[0];
    let poses = browser.poses().await;
    for known in &sample.objects {
        let shown = poses.iter().find(|pose| pose.object == known.object).unwrap();
        // A film has half the colours and comes as a JPEG: not quite the sample.
        assert!(shown.error(known) < 0.2, "{shown:?}");
    }
    assert_eq!(browser.complaints().await, [""; 0]);

    let addresses = [server.http, server.grpc, server.admin];
    drop(server);
    browser.until_text("#try-problem", "The server does not answer. Trying again").await;
    let _server = Server::start_on(addresses, &[]);
    browser.until(&format!("document.querySelector('#try-problem').innerText === '' && {FIGURES}")).await;

    browser.press("Stop").await;
    browser.until("document.querySelector('#try-figures').innerText === '' && document.querySelector('#try-sources video') === null").await;
}

/// While others take all places, it waits longer from one try to the next, and goes on once there is room.
#[tokio::test(flavor = "multi_thread")]
async fn a_busy_server_is_left_in_peace() {
    let folder = tempfile::tempdir().unwrap();
    let (server, browser) = (Arc::new(Server::start(&["--queue", "1"])), with_camera(&folder).await);
    go_live(&browser, &server).await;
    let busy = Arc::new(AtomicBool::new(true));
    let others: Vec<_> = (0..6)
        .map(|_| {
            let (server, busy) = (Arc::clone(&server), Arc::clone(&busy));
            tokio::spawn(async move {
                while busy.load(Ordering::Relaxed) {
                    post(&server, CAMERA, read(&samples()[0].file)).await;
                }
            })
        })
        .collect();
    browser.until_text("#try-problem", "Slowing down. Trying again in 1 s").await;
    browser.until_text("#try-problem", "Slowing down. Trying again in 2 s").await;
    busy.store(false, Ordering::Relaxed);
    for other in others {
        other.await.unwrap();
    }
    browser.until(&format!("document.querySelector('#try-problem').innerText === '' && {FIGURES}")).await;
}

#[tokio::test]
async fn one_picture_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (server, browser) = (Server::start(&[]), with_camera(&folder).await);
    browser.open(&server.url("/")).await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    browser.press("Take a picture").await;
    assert!(browser.poses().await.len() >= 4);
}
