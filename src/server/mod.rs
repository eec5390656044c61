//! HTTP and gRPC, both thin: they translate a request, ask the queue, and translate the answer.

mod admin;
pub mod api;
mod cameras;
mod failure;
mod grpc;
mod http;
mod marks;
mod metrics;
mod request;
mod run;
mod settings;
mod settings_file;
mod telemetry;

pub use cameras::{CameraError, Cameras};
pub use http::openapi;
pub use run::{ServeError, run};
pub use settings::{Config, LogFormat, SettingsError};
pub use settings_file::{SettingsFile, SettingsFileError, default_settings};
pub use telemetry::{LogControl, init_logs};

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::estimator::{Answer, Queue, Work};
use crate::model::{Library, ModelsInUse, References};
use failure::Failure;
use metrics::Metrics;
use request::Options;

/// What every handler needs.
type App = Arc<Shared>;

struct Shared {
    queue: Queue,
    library: Arc<Library>,
    references: Arc<References>,
    cameras: Cameras,
    models: ModelsInUse,
    config: Config,
    metrics: Metrics,
    /// One recalibration at a time: two of one object would mix their images.
    recalibrating: tokio::sync::Mutex<()>,
}

impl Shared {
    /// Poses from one encoded image.
    async fn estimate(
        &self,
        image: Vec<u8>,
        options: &Options,
        deadline: Instant,
        keep_image: bool,
    ) -> Result<Answer, Failure> {
        let Options { camera, selection, .. } = options;
        let work = Work { image, camera: camera.clone(), selection: selection.clone(), keep_image, deadline };
        let answer = self.queue.estimate(work).await?;
        self.metrics.answer(&answer);
        Ok(answer)
    }

    /// When a request's time is over: what it asks for, within the limit.
    fn deadline(&self, asked: Option<Duration>) -> Instant {
        let longest = Duration::from_millis(self.config.max_timeout_ms);
        let usual = Duration::from_millis(self.config.timeout_ms);
        Instant::now() + asked.map_or(usual, |asked| asked.min(longest))
    }

    fn is_calibrated(&self, object: &str) -> bool {
        self.references.get(object).is_some()
    }
}
