//! Nobody is kept out: axe-core finds nothing serious, text can be read, nothing hangs over the edge.

use serde_json::Value;

use crate::browser::Browser;
use crate::support::{Server, read, root};

const SMALL: &str = "const small = []; \
    for (const element of document.querySelectorAll('body *')) { \
      const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim()); \
      const size = parseFloat(getComputedStyle(element).fontSize); \
      if (own && element.checkVisibility() && size < 14) small.push(`${element.tagName} ${size} ${element.textContent}`); \
    } \
    return small;";
const AXE: &str = "return axe.run(document, {resultTypes: ['violations']}).then(({violations}) => violations \
    .filter(({impact}) => impact === 'serious' || impact === 'critical') \
    .map(({id, nodes}) => `${id}: ${nodes.map(({html, failureSummary}) => html.slice(0, 200) + failureSummary).join(' | ')}`));";

#[tokio::test]
async fn every_view_is_for_everybody() {
    let axe = root().join(".tools/axe/axe.min.js");
    assert!(axe.is_file(), "no {}: run scripts/fetch-axe.sh", axe.display());
    let axe = String::from_utf8(read(&axe)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let empty = ["--recalibration", "--reference", folder.path().to_str().unwrap()];
    let (server, browser) = (Server::start(&empty), Browser::start().await);
    let calibrated = Server::start(&[]);
    for (view, ready) in [
        ("try", "document.querySelectorAll('#try-answer tbody tr').length"),
        ("objects", "document.querySelector('[aria-labelledby=object-cube]')"),
        ("reference", "document.querySelector('#reference textarea').value"),
        ("status", "document.querySelectorAll('#status dd').length"),
    ] {
        // One with references, and one whose objects have none.
        for server in [&calibrated, &server] {
            browser.open(&server.url(&format!("/#{view}"))).await;
            match view {
                "try" => {
                    browser.until("document.querySelectorAll('.thumbnail').length").await;
                    browser.click(".thumbnail").await;
                    browser.until("document.querySelector('#try-answer .summary').innerText").await;
                }
                "reference" => {
                    browser.until("document.querySelector('#reference-object').options.length").await;
                    browser.press("Use the sample images").await;
                    browser.until(ready).await;
                    browser.click_at("#reference-first canvas.pick", 100.0, 100.0).await;
                }
                _ => {
                    browser.until(ready).await;
                }
            }
            browser.run(&axe, Value::Null).await;
            for (width, dark) in [(1200, false), (360, true)] {
                browser.look_like(width, 900, dark).await;
                let place = format!("{view}, {width} px, dark: {dark}");
                assert_eq!(browser.run(AXE, Value::Null).await, Value::Array(Vec::new()), "{place}");
                assert_eq!(browser.run(SMALL, Value::Null).await, Value::Array(Vec::new()), "{place}");
                let over = browser.run("return document.documentElement.scrollWidth - innerWidth;", Value::Null).await;
                assert!(over.as_i64().unwrap() <= 0, "{place}: {over} px hang over the edge");
            }
        }
    }
    assert_eq!(browser.complaints().await, [""; 0]);
}
