//! The view Try.

use std::time::Duration;

use image::ImageFormat;
use serde_json::Value;
use thirtyfour::Key;

use crate::browser::Browser;
use crate::support::{Sample, Server, error, read, root, samples};

/// A pose in the table is that of the sample.
async fn assert_shown(browser: &Browser, sample: &Sample) {
    let poses = browser.poses().await;
    for known in &sample.objects {
        let shown = poses.iter().find(|pose| pose.object == known.object);
        let shown = shown.unwrap_or_else(|| panic!("{} is not in {poses:?}", known.object));
        assert!(shown.error(known) < 0.1, "{shown:?}");
    }
}

#[tokio::test]
async fn a_sample_is_answered_after_one_click() {
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    browser.open(&server.url("/")).await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    browser.click(".thumbnail").await;
    assert_shown(&browser, &samples()[0]).await;
    // The bracket is right, but many that look like it are not.
    browser.until_text("#try-answer", "4 objects, 3 of them ok.").await;
    browser.until_text("#try-answer", "Too many poses like this one are wrong").await;
    browser.until_text("#try-answer", "Round trip").await;
    // Pointing at a row changes the picture: the others become faint.
    let picture = "document.querySelector('#try-answer canvas').toDataURL()";
    let whole = browser.run(&format!("return {picture};"), Value::Null).await;
    browser.run("document.querySelector('#try-answer tbody tr').focus();", Value::Null).await;
    assert_ne!(browser.run(&format!("return {picture};"), Value::Null).await, whole);
    assert_eq!(browser.complaints().await, [""; 0]);
}

#[tokio::test]
async fn everything_can_be_done_by_keyboard() {
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    browser.open(&server.url("/")).await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    let mut presses = 0;
    while browser.run("return document.activeElement.className;", Value::Null).await != "thumbnail" {
        browser.driver.action_chain().send_keys(Key::Tab.value().to_string()).perform().await.unwrap();
        presses += 1;
        assert!(presses < 30, "no way to the samples");
    }
    browser.driver.action_chain().send_keys(Key::Enter.value().to_string()).perform().await.unwrap();
    assert_shown(&browser, &samples()[0]).await;
}

#[tokio::test]
async fn a_file_is_answered_and_a_wrong_one_explained() {
    let (server, browser) = (Server::start(&["--timeout-ms", "60000"]), Browser::start().await);
    browser.open(&server.url("/")).await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    browser.choose("Choose an image", &samples()[1].file).await;
    assert_shown(&browser, &samples()[1]).await;
    let poses = browser.poses().await;
    for known in &samples()[1].objects {
        assert!(poses.iter().any(|pose| pose.object == known.object && pose.status == "ok"), "{poses:?}");
    }

    // The service's own sentences.
    let client = reqwest::Client::new();
    for (file, content_type) in [("README.md", "text/markdown"), ("tests/data/claims-60000x60000.png", "image/png")] {
        let post = client.post(server.url("/v1/poses?camera=demo")).header("content-type", content_type);
        let sentence = error(post.body(read(&root().join(file))).send().await.unwrap()).await.1;
        browser.choose("Choose an image", file.as_ref()).await;
        browser.until_text("#try-problem", &sentence).await;
        assert_eq!(browser.text("#try-answer").await.trim(), "");
    }

    // The next good one works. It is larger than a screen, and posted whole.
    let folder = tempfile::tempdir().unwrap();
    let large = folder.path().join("large.jpg");
    let sample = image::open(&samples()[0].file).unwrap();
    sample
        .resize_exact(5600, 4200, image::imageops::FilterType::Triangle)
        .save_with_format(&large, ImageFormat::Jpeg)
        .unwrap();
    browser.choose("Choose an image", &large).await;
    browser.until_text("#try-problem", "allow_resize").await;
    browser.until_text("#try-camera", "calibrated for 640 × 480 pixels, but the image has 5600 × 4200").await;
    browser.click("#try-camera input[type=checkbox]").await;
    assert_shown(&browser, &samples()[0]).await;
    let width = browser.run("return document.querySelector('#try-answer canvas').width;", Value::Null).await;
    assert!(width.as_u64().unwrap() < 1500, "{width}");
}

/// A camera that is not calibrated is marked as a guess, and one with its numbers in wrong places is told.
#[tokio::test]
async fn doubtful_cameras_are_told() {
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    browser.open(&server.url("/")).await;
    browser.until("document.querySelectorAll('.thumbnail').length").await;
    browser.click(".thumbnail").await;
    browser.poses().await;
    browser.click("#try-camera input[value=guess]").await;
    browser.until_text("#try-answer .summary", "The camera is a guess").await;
    browser.click("#try-camera input[value=numbers]").await;
    // Swapped: the middle of an image of 480 x 640.
    for (name, value) in [("cx", "239.5"), ("cy", "319.5")] {
        browser.fill(name, value).await;
    }
    browser.until_text("#try-camera", "cx and cy seem to be swapped").await;
    for (name, value) in [("cx", "319.5"), ("cy", "450")] {
        browser.fill(name, value).await;
    }
    browser.until_text("#try-camera", "far from the middle").await;
    // The server doubts it, too.
    browser.until_text("#try-answer", "Does the camera belong to this image?").await;
    browser.fill("fx", " ").await;
    browser.until_text("#try-camera", "Give numbers for fx").await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(browser.complaints().await, [""; 0]);
}
