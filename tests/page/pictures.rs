//! Pictures of every view for people to look at, and how long the page takes to appear. `make page-pictures`.

use std::fs;

use serde_json::Value;

use crate::browser::Browser;
use crate::clicks::{Scene, click_corners};
use crate::support::Server;

#[tokio::test]
#[ignore = "for people: it writes pictures into POSED_PICTURES"]
async fn pictures_of_every_view() {
    let folder = std::env::var("POSED_PICTURES").unwrap_or_else(|_| "pictures".into());
    fs::create_dir_all(&folder).unwrap();
    let (server, browser) = (Server::start(&[]), Browser::start().await);
    let mut paints_ms = Vec::new();
    for _ in 0..10 {
        browser.open("about:blank").await;
        browser.open(&server.url("/")).await;
        let paint = browser.until("performance.getEntriesByName('first-contentful-paint')[0]?.startTime").await;
        paints_ms.push(paint.as_f64().unwrap());
    }
    println!("first contentful paint, ms: {paints_ms:?}");
    for (view, ready) in [
        ("try", "document.querySelectorAll('.thumbnail').length"),
        ("objects", "document.querySelectorAll('#objects canvas').length === 4"),
        ("reference", "document.querySelector('#reference-object').options.length"),
        ("status", "document.querySelectorAll('#status dd').length"),
    ] {
        browser.open(&server.url(&format!("/#{view}"))).await;
        browser.until(ready).await;
        if view == "try" {
            browser.click(".thumbnail:last-child").await;
            browser.poses().await;
        } else if view == "reference" {
            click_corners(&browser, &Scene::read()).await;
        }
        for (name, width, dark) in [("light", 1200, false), ("dark", 1200, true), ("phone", 375, false)] {
            browser.look_like(width, 900, dark).await;
            let height =
                browser.run("scrollTo(0, 0); return document.documentElement.scrollHeight;", Value::Null).await;
            browser.look_like(width, u32::try_from(height.as_u64().unwrap()).unwrap(), dark).await;
            tokio::time::sleep(std::time::Duration::from_millis(700)).await;
            let picture = browser.driver.screenshot_as_png().await.unwrap();
            fs::write(format!("{folder}/{view}-{name}.png"), picture).unwrap();
        }
        browser.look_like(1200, 1000, false).await;
    }
}
