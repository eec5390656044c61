//! A headless Chromium.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use thirtyfour::LoggingPrefsLogLevel;
use thirtyfour::prelude::*;

use crate::support::{KnownObject, root};

/// Debug builds on a busy machine answer an image in seconds.
const PATIENCE: Duration = Duration::from_mins(1);
const MISSING: &str =
    "the tests of the page need Debian's chromium and chromium-driver: run scripts/install-chromium.sh";

pub(crate) struct Browser {
    pub(crate) driver: WebDriver,
    chromedriver: Child,
    port: u16,
}

const ATTEMPTS: usize = 5;

/// `None` where it ends at once.
fn start_chromedriver() -> Option<(Child, u16)> {
    let command = &mut Command::new("chromedriver");
    let started = command.arg("--port=0").stdout(Stdio::piped()).spawn();
    let mut chromedriver = started.unwrap_or_else(|error| panic!("{error}; {MISSING}"));
    let mut lines = BufReader::new(chromedriver.stdout.take().unwrap()).lines().map_while(Result::ok);
    let Some(port) = lines.find_map(|line| Some(line.split_once("successfully on port ")?.1.to_owned())) else {
        chromedriver.wait().unwrap();
        return None;
    };
    // Someone must go on reading, or it would block on a full pipe.
    std::thread::spawn(move || lines.for_each(drop));
    Some((chromedriver, port.trim_end_matches('.').parse().unwrap()))
}

impl Browser {
    pub(crate) async fn start() -> Self {
        Self::with(&[]).await
    }

    /// With more arguments.
    pub(crate) async fn with(arguments: &[String]) -> Self {
        // It takes a free port of IPv4, and gives up where that of IPv6 is in use.
        let started = (0..ATTEMPTS).find_map(|_| start_chromedriver());
        let (chromedriver, port) = started.unwrap_or_else(|| panic!("{MISSING}"));
        let mut capabilities = DesiredCapabilities::chrome();
        let usual = [
            "--headless=new",
            // Chromium's own sandbox wants another user than root.
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--window-size=1200,1000",
            "--use-fake-device-for-media-stream",
            "--use-fake-ui-for-media-stream",
        ];
        for argument in usual.into_iter().map(str::to_owned).chain(arguments.iter().cloned()) {
            capabilities.add_arg(&argument).unwrap();
        }
        capabilities.set_browser_log_level(LoggingPrefsLogLevel::All).unwrap();
        let driver = WebDriver::new(format!("http://127.0.0.1:{port}"), capabilities)
            .await
            .unwrap_or_else(|error| panic!("{error}; {MISSING}"));
        Self { driver, chromedriver, port }
    }

    pub(crate) async fn open(&self, url: &str) {
        self.driver.goto(url).await.unwrap();
    }

    /// What a script returns; promises are waited for.
    pub(crate) async fn run(&self, script: &str, argument: Value) -> Value {
        self.driver.execute(script, vec![argument]).await.unwrap().json().clone()
    }

    /// Waits until an expression is true, and returns it.
    pub(crate) async fn until(&self, expression: &str) -> Value {
        let start = Instant::now();
        loop {
            let value = self.run(&format!("return {expression};"), Value::Null).await;
            if !matches!(value, Value::Null | Value::Bool(false)) && value != "" && value != 0 {
                return value;
            }
            if start.elapsed() > PATIENCE {
                let page = self.text("main").await;
                panic!("never true: {expression}\n{page}");
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// The visible text of an element.
    pub(crate) async fn text(&self, css: &str) -> String {
        self.run("return document.querySelector(arguments[0]).innerText;", css.into())
            .await
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// Waits until an element's text has some words.
    pub(crate) async fn until_text(&self, css: &str, words: &str) {
        let (css, words) = (Value::from(css), Value::from(words));
        self.until(&format!("document.querySelector({css})?.innerText.includes({words})")).await;
    }

    pub(crate) async fn click(&self, css: &str) {
        self.driver.find(By::Css(css)).await.unwrap().click().await.unwrap();
    }

    /// Clicks a button by its words.
    pub(crate) async fn press(&self, words: &str) {
        let path = format!("//button[normalize-space()='{words}' and not(ancestor::section[@hidden])]");
        self.driver.find(By::XPath(&*path)).await.unwrap().click().await.unwrap();
    }

    /// Hands a file to the input with this label.
    pub(crate) async fn choose(&self, label: &str, file: &Path) {
        let path = format!("//label[normalize-space()='{label}']/input");
        let input = self.driver.find(By::XPath(&*path)).await.unwrap();
        input.send_keys(root().join(file).to_str().unwrap()).await.unwrap();
    }

    /// Types into the control of a label.
    pub(crate) async fn fill(&self, label: &str, text: &str) {
        let path = format!("//*[@id=//label[normalize-space()='{label}' and not(ancestor::*[@hidden])]/@for]");
        let input = self.driver.find(By::XPath(&*path)).await.unwrap();
        input.clear().await.unwrap();
        input.send_keys(text).await.unwrap();
    }

    /// Clicks a place of an element, in pixels of the screen from its upper left corner, as near as a mouse comes.
    #[expect(clippy::cast_possible_truncation, reason = "a place on the screen")]
    pub(crate) async fn click_at(&self, css: &str, x: f64, y: f64) {
        let script = "const element = document.querySelector(arguments[0]); element.scrollIntoView({block: 'center'}); \
                      const {left, top} = element.getBoundingClientRect(); \
                      return [left + element.clientLeft, top + element.clientTop];";
        let corner: [f64; 2] = serde_json::from_value(self.run(script, css.into()).await).unwrap();
        let (x, y) = ((corner[0] + x).round() as i64, (corner[1] + y).round() as i64);
        self.driver.action_chain().move_to(x, y).click().perform().await.unwrap();
    }

    /// What the browser complained of.
    pub(crate) async fn complaints(&self) -> Vec<String> {
        let log = self.driver.browser_log().await.unwrap();
        log.into_iter()
            .filter(|entry| entry.level != "INFO" && entry.level != "DEBUG")
            .map(|entry| entry.message)
            .collect()
    }

    /// The width of the window and whether the system is dark.
    pub(crate) async fn look_like(&self, width: u32, height: u32, dark: bool) {
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        let scheme = if dark { "dark" } else { "light" };
        let media = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        let cdp = self.driver.cdp();
        cdp.send_raw("Emulation.setDeviceMetricsOverride", metrics).await.unwrap();
        cdp.send_raw("Emulation.setEmulatedMedia", media).await.unwrap();
    }

    /// The poses in the table, by object.
    pub(crate) async fn poses(&self) -> Vec<Pose> {
        self.until("document.querySelectorAll('#try-answer tbody tr').length").await;
        let script = "return [...document.querySelectorAll('#try-answer tbody tr')].map((row) => \
                      [...row.cells].map((cell) => cell.innerText));";
        let rows: Vec<Vec<String>> = serde_json::from_value(self.run(script, Value::Null).await).unwrap();
        rows.iter().map(|cells| Pose::read(cells)).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Its own way to end waits for two minutes where the driver is gone already.
        let _ = self.driver.clone().leak();
        // The browsers of a driver end with it only where it is asked.
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) {
            let _ = stream.write_all(b"GET /shutdown HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n");
            let _ = stream.set_read_timeout(Some(Duration::from_secs(10)));
            let _ = stream.read(&mut [0; 256]);
        }
        let _ = self.chromedriver.kill();
        let _ = self.chromedriver.wait();
    }
}

/// A row of the table.
#[derive(Debug, PartialEq)]
pub(crate) struct Pose {
    pub(crate) object: String,
    pub(crate) status: String,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
}

impl Pose {
    fn read(cells: &[String]) -> Self {
        let numbers = |cell: usize| -> Vec<f64> {
            cells[cell].replace('−', "-").split(", ").map(|number| number.parse().unwrap()).collect()
        };
        let metres: Vec<f64> = numbers(3).iter().map(|millimetres| millimetres / 1e3).collect();
        let turn = numbers(5);
        // Rounded for people; to be read as a pose it needs its length again.
        let length = turn.iter().map(|part| part * part).sum::<f64>().sqrt();
        let unit: Vec<f64> = turn.iter().map(|part| part / length).collect();
        Self {
            object: cells[0].clone(),
            status: cells[1].clone(),
            rotation_xyzw: unit.try_into().unwrap(),
            translation_m: metres.try_into().unwrap(),
        }
    }

    /// ADD over the diameter.
    pub(crate) fn error(&self, known: &KnownObject) -> f64 {
        known.error(self.rotation_xyzw, self.translation_m)
    }
}
