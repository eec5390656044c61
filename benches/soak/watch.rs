//! The server from outside, all the time: its memory, and whether probes are answered.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::process::Server;

/// Resident memory at one time.
pub struct Sample {
    pub at: Duration,
    pub mib: f64,
}

const SAMPLES: Duration = Duration::from_secs(1);

/// Samples memory until the server is dead, or for ever.
pub async fn memory(server: &Server, start: Instant, samples: &mut Vec<Sample>) {
    let mut ticks = tokio::time::interval(SAMPLES);
    while let Some(memory) = server.memory() {
        samples.push(Sample { at: start.elapsed(), mib: memory.now });
        ticks.tick().await;
    }
}

/// What probes got.
#[derive(Default)]
pub struct Probed {
    pub milliseconds: Vec<f64>,
    pub not_ready: usize,
    pub failed: usize,
}

/// Asks `/readyz` and `/livez`, as an orchestrator does, with a connection each.
pub struct Probes {
    ended: Arc<AtomicBool>,
    thread: JoinHandle<Probed>,
}

const PROBES: Duration = Duration::from_millis(100);
const PATIENCE: Duration = Duration::from_secs(10);

impl Probes {
    /// In a thread of their own, so that they do not wait for the other clients here.
    pub fn start(admin: SocketAddr) -> Self {
        let ended = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&ended);
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async move {
                let client = reqwest::Client::builder().pool_max_idle_per_host(0).timeout(PATIENCE).build().unwrap();
                let urls = ["readyz", "livez"].map(|probe| format!("http://{admin}/{probe}"));
                let mut probed = Probed::default();
                while !stop.load(Ordering::Relaxed) {
                    for url in &urls {
                        probed.ask(&client, url).await;
                    }
                    tokio::time::sleep(PROBES).await;
                }
                probed
            })
        });
        Self { ended, thread }
    }

    pub fn end(self) -> Probed {
        self.ended.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

impl Probed {
    async fn ask(&mut self, client: &reqwest::Client, url: &str) {
        let start = Instant::now();
        match client.get(url).send().await {
            Ok(response) => {
                self.milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
                self.not_ready += usize::from(!response.status().is_success());
            }
            Err(_) => self.failed += 1,
        }
    }
}
