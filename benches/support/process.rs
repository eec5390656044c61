//! The server as its operator sees it.
#![allow(dead_code, unreachable_pub, reason = "each bench uses a part of this")]

use std::net::{SocketAddr, TcpListener};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::Value;

pub struct Server {
    child: Child,
    client: Client,
    pub http: SocketAddr,
    pub grpc: SocketAddr,
    pub admin: SocketAddr,
    /// From start to ready.
    pub started_s: f64,
}

/// Resident memory, MiB.
#[derive(Clone, Copy)]
pub struct Memory {
    pub now: f64,
    /// The most that it ever was.
    pub peak: f64,
}

impl Server {
    pub async fn start(settings: &[&str]) -> Self {
        let free = || TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let (http, grpc, admin) = (free(), free(), free());
        let start = Instant::now();
        let child = Command::new(env!("CARGO_BIN_EXE_posed"))
            .args(["serve", "--cameras", "samples", "--log", "error"])
            .args(settings)
            .args(["--http", &http.to_string(), "--grpc", &grpc.to_string(), "--admin", &admin.to_string()])
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let client = Client::new();
        let ready = format!("http://{admin}/readyz");
        while !client.get(&ready).send().await.is_ok_and(|response| response.status().is_success()) {
            assert!(start.elapsed() < Duration::from_mins(1), "the server did not become ready");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        Self { child, client, http, grpc, admin, started_s: start.elapsed().as_secs_f64() }
    }

    pub fn request(&self, image: Vec<u8>) -> reqwest::RequestBuilder {
        self.client.post(format!("http://{}/v1/poses?camera=demo", self.http)).body(image)
    }

    pub async fn post(&self, image: Vec<u8>) -> Value {
        self.post_for(image, &[]).await
    }

    /// Of some objects only; none is all.
    pub async fn post_for(&self, image: Vec<u8>, objects: &[&str]) -> Value {
        let names = [("objects", objects.join(","))];
        let request = self.request(image).query(if objects.is_empty() { &names[..0] } else { &names });
        let response = request.send().await.unwrap();
        assert!(response.status().is_success());
        serde_json::from_slice(&response.bytes().await.unwrap()).unwrap()
    }

    /// What it says of itself.
    pub async fn get(&self, path: &str) -> Value {
        let url = format!("http://{}{path}", self.http);
        let response = Client::new().get(url).send().await.unwrap().error_for_status().unwrap();
        serde_json::from_slice(&response.bytes().await.unwrap()).unwrap()
    }

    pub fn rss_mib(&self) -> f64 {
        self.memory().unwrap().now
    }

    /// `None` once it is dead.
    pub fn memory(&self) -> Option<Memory> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let mib = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name))?;
            Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0)
        };
        Some(Memory { now: mib("VmRSS:")?, peak: mib("VmHWM:")? })
    }

    pub fn threads(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/task", self.child.id())).map_or(0, Iterator::count)
    }

    pub fn sockets(&self) -> usize {
        let Ok(files) = std::fs::read_dir(format!("/proc/{}/fd", self.child.id())) else { return 0 };
        let targets = files.filter_map(|file| std::fs::read_link(file.ok()?.path()).ok());
        targets.filter(|target| target.to_string_lossy().starts_with("socket:")).count()
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
        // It may be dead already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
