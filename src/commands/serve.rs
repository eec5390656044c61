use std::error::Error;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::ModelArgs;
use crate::estimator::{Estimator, Queue};
use crate::model::Store;
use crate::server::{self, Cameras};
use crate::vision::ImageLimits;

#[derive(Args, Debug)]
#[expect(clippy::doc_markdown, reason = "the comments are the help text")]
pub(super) struct Serve {
    #[command(flatten)]
    models: ModelArgs,
    /// Address of the HTTP server.
    #[arg(long, env = "POSED_HTTP", default_value = "0.0.0.0:8080")]
    http: SocketAddr,
    /// Address of the gRPC server.
    #[arg(long, env = "POSED_GRPC", default_value = "0.0.0.0:9000")]
    grpc: SocketAddr,
    /// Folder of registered cameras: `left.camera.json` is camera `left`.
    #[arg(long, env = "POSED_CAMERAS")]
    cameras: Option<PathBuf>,
    /// Images in work or waiting; one more is refused with 429 or RESOURCE_EXHAUSTED.
    #[arg(long, env = "POSED_QUEUE", default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..))]
    queue: u16,
    /// Largest request body, bytes.
    #[arg(long, env = "POSED_MAX_BODY_BYTES", default_value_t = 16 * 1024 * 1024)]
    max_body_bytes: usize,
    /// Largest width or height of an image, pixels.
    #[arg(long, env = "POSED_MAX_SIDE_PX", default_value_t = ImageLimits::default().max_side_px)]
    max_side_px: u32,
    /// Largest image, pixels.
    #[arg(long, env = "POSED_MAX_PIXELS", default_value_t = ImageLimits::default().max_pixels)]
    max_pixels: u64,
    /// Seconds that accepted requests have to finish after a shutdown signal.
    #[arg(long, env = "POSED_DRAIN_SECONDS", default_value_t = 10)]
    drain_seconds: u64,
}

impl Serve {
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let cameras = self.cameras.as_deref().map(Cameras::read).transpose()?.unwrap_or_default();
        let store = Store::load(&self.models.paths(), &self.models.runtime()?)?;
        for (name, reason) in store.unserved() {
            tracing::warn!("{name} is not served: {reason}");
        }
        let names: Vec<&str> = store.calibrated().map(|model| model.manifest.name.as_str()).collect();
        tracing::info!("objects: {}", names.join(", "));
        let estimator = Estimator::new(store);
        let limits = ImageLimits { max_side_px: self.max_side_px, max_pixels: self.max_pixels };
        let (queue, worker) = Queue::start(estimator, usize::from(self.queue), limits)?;
        let config = server::Config {
            http: self.http,
            grpc: self.grpc,
            max_body_bytes: self.max_body_bytes,
            drain: Duration::from_secs(self.drain_seconds),
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let served = runtime.block_on(server::run(config, queue, cameras));
        let drained = served.is_ok();
        // Drops what is left of the connections, and with them the last ends of the queue.
        runtime.shutdown_background();
        if drained && worker.is_finished() {
            // Joining a finished thread returns at once; a panic in it has been logged.
            let _ = worker.join();
        }
        Ok(served?)
    }
}
