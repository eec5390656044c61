//! The server as its operator sees it.
#![allow(unreachable_pub, reason = "for the bench alone")]

use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::Value;

pub struct Server {
    child: Child,
    client: Client,
    url: String,
    /// From start to ready.
    pub started_s: f64,
}

impl Server {
    pub async fn start() -> Self {
        let free = || TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
        let (http, grpc, admin) = (free(), free(), free());
        let start = Instant::now();
        let child = Command::new(env!("CARGO_BIN_EXE_posed"))
            .args([
                "serve",
                "--http",
                &http,
                "--grpc",
                &grpc,
                "--admin",
                &admin,
                "--cameras",
                "samples",
                "--log",
                "error",
            ])
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let client = Client::new();
        let ready = format!("http://{admin}/readyz");
        while !client.get(&ready).send().await.is_ok_and(|response| response.status().is_success()) {
            assert!(start.elapsed() < Duration::from_mins(1), "the server did not become ready");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let url = format!("http://{http}/v1/poses?camera=demo");
        Self { child, client, url, started_s: start.elapsed().as_secs_f64() }
    }

    pub fn request(&self, image: Vec<u8>) -> reqwest::RequestBuilder {
        self.client.post(&self.url).body(image)
    }

    pub async fn post(&self, image: Vec<u8>) -> Value {
        let response = self.request(image).send().await.unwrap();
        assert!(response.status().is_success());
        serde_json::from_slice(&response.bytes().await.unwrap()).unwrap()
    }

    pub fn rss_mib(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1024.0
    }

    /// Over ten seconds without requests.
    pub async fn idle_cpu_percent(&self) -> f64 {
        let seconds = 10;
        let before = self.cpu_ticks();
        tokio::time::sleep(Duration::from_secs(seconds)).await;
        // Linux counts in hundredths of a second.
        (self.cpu_ticks() - before) / seconds as f64
    }

    fn cpu_ticks(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}
