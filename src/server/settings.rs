//! Settings from the defaults, a file, the environment and flags; checked before anything is loaded or bound.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::estimator::QueueConfig;
use crate::model::{Provider, available_cores};
use crate::vision::{DecodeOptions, OrientationPolicy};

/// The commented defaults.
pub const DEFAULT_SETTINGS: &str = include_str!("posed.toml");

/// Settings as they are written: all optional. `posed serve --print-config` explains them.
#[derive(Args, Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Address of the HTTP server [default: 0.0.0.0:8080].
    #[arg(long, env = "POSED_HTTP")]
    http: Option<SocketAddr>,
    /// Address of the gRPC server [default: 0.0.0.0:9000].
    #[arg(long, env = "POSED_GRPC")]
    grpc: Option<SocketAddr>,
    /// Address of probes, metrics and the log level [default: 0.0.0.0:8081].
    #[arg(long, env = "POSED_ADMIN")]
    admin: Option<SocketAddr>,
    /// Folder with `detector/` and one folder for each object [default: models].
    #[arg(long, env = "POSED_MODELS")]
    models: Option<PathBuf>,
    /// Folder with `<object>.json` for each calibrated object [default: reference].
    #[arg(long, env = "POSED_REFERENCE")]
    reference: Option<PathBuf>,
    /// Folder of registered cameras: `left.camera.json` is camera `left`.
    #[arg(long, env = "POSED_CAMERAS")]
    cameras: Option<PathBuf>,
    /// Let clients replace references [default: false].
    #[arg(long, env = "POSED_RECALIBRATION", num_args = 0..=1, default_missing_value = "true")]
    recalibration: Option<bool>,
    /// What to do with an image that asks to be turned [default: refuse].
    #[arg(long, env = "POSED_EXIF_ORIENTATION", value_enum)]
    exif_orientation: Option<OrientationPolicy>,
    /// What the networks run on [default: cpu].
    #[arg(long, env = "POSED_PROVIDER", value_enum)]
    provider: Option<Provider>,
    /// Threads that each own a set of networks [default: 1].
    #[arg(long, env = "POSED_WORKERS")]
    workers: Option<usize>,
    /// Threads that each network runs on [default: the cores this process may use, shared among the workers].
    #[arg(long, env = "POSED_THREADS")]
    threads: Option<usize>,
    /// Images whose crops go through a keypoint net together [default: 8].
    #[arg(long, env = "POSED_MAX_BATCH")]
    max_batch: Option<usize>,
    /// How long such a batch waits for company, milliseconds [default: 0].
    #[arg(long, env = "POSED_BATCH_DELAY_MS")]
    batch_delay_ms: Option<u64>,
    /// Images in work or waiting; one more is refused [default: 16].
    #[arg(long, env = "POSED_QUEUE")]
    queue: Option<usize>,
    /// Bytes of images in work or waiting [default: 134217728].
    #[arg(long, env = "POSED_QUEUE_BYTES")]
    queue_bytes: Option<usize>,
    /// Largest request body or gRPC message, bytes [default: 16777216].
    #[arg(long, env = "POSED_MAX_BODY_BYTES")]
    max_body_bytes: Option<usize>,
    /// Largest width or height of an image, pixels [default: 8192].
    #[arg(long, env = "POSED_MAX_SIDE_PX")]
    max_side_px: Option<u32>,
    /// Largest image, pixels [default: 24000000].
    #[arg(long, env = "POSED_MAX_PIXELS")]
    max_pixels: Option<u64>,
    /// Images in one batch request [default: 16].
    #[arg(long, env = "POSED_MAX_BATCH_IMAGES")]
    max_batch_images: Option<usize>,
    /// Time that a request has by default, milliseconds [default: 10000].
    #[arg(long, env = "POSED_TIMEOUT_MS")]
    timeout_ms: Option<u64>,
    /// Time that a request may ask for, milliseconds [default: 60000].
    #[arg(long, env = "POSED_MAX_TIMEOUT_MS")]
    max_timeout_ms: Option<u64>,
    /// Time that accepted requests have to finish after a shutdown signal, seconds [default: 10].
    #[arg(long, env = "POSED_DRAIN_SECONDS")]
    drain_seconds: Option<u64>,
    /// Log level or filter [default: info,ort=warn].
    #[arg(long, env = "POSED_LOG")]
    log: Option<String>,
    /// Form of the log [default: pretty].
    #[arg(long, env = "POSED_LOG_FORMAT", value_enum)]
    log_format: Option<LogFormat>,
}

/// How log lines look.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    #[default]
    Pretty,
    Json,
}

/// Settings with every value known and possible.
#[derive(Clone, Debug, Deserialize)]
pub struct Config {
    pub http: SocketAddr,
    pub grpc: SocketAddr,
    pub admin: SocketAddr,
    pub models: PathBuf,
    pub reference: PathBuf,
    pub cameras: Option<PathBuf>,
    pub recalibration: bool,
    pub exif_orientation: OrientationPolicy,
    pub provider: Provider,
    pub workers: usize,
    pub threads: Option<usize>,
    pub max_batch: usize,
    pub batch_delay_ms: u64,
    pub queue: usize,
    pub queue_bytes: usize,
    pub max_body_bytes: usize,
    pub max_side_px: u32,
    pub max_pixels: u64,
    pub max_batch_images: usize,
    pub timeout_ms: u64,
    pub max_timeout_ms: u64,
    pub drain_seconds: u64,
    pub log: String,
    pub log_format: LogFormat,
}

/// Settings that cannot be served with.
#[derive(Debug, Error)]
pub enum SettingsError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {source}", path.display())]
    File { path: PathBuf, source: Box<toml::de::Error> },
    #[error("the settings do not fit together: {0}")]
    Merge(String),
    #[error("setting '{setting}' is {value}; it must lie between {least} and {most}")]
    Range { setting: &'static str, value: u64, least: u64, most: u64 },
    #[error("setting 'queue_bytes' is {queue_bytes}: less than one body may have ('max_body_bytes', {max_body_bytes})")]
    QueueBytes { queue_bytes: usize, max_body_bytes: usize },
    #[error(
        "setting 'timeout_ms' is {timeout_ms}: more than a request may ask for ('max_timeout_ms', {max_timeout_ms})"
    )]
    Timeout { timeout_ms: u64, max_timeout_ms: u64 },
}

impl Config {
    /// Flags and environment over a file, if there is one, over the defaults.
    ///
    /// # Errors
    /// When the file has an unknown or impossible setting, or a value is out of its range.
    pub fn new(flags: &Settings, file: Option<&Path>) -> Result<Self, SettingsError> {
        let mut table = read(DEFAULT_SETTINGS, Path::new("defaults"))?;
        if let Some(path) = file {
            let text =
                std::fs::read_to_string(path).map_err(|source| SettingsError::Read { path: path.into(), source })?;
            table.extend(read(&text, path)?);
        }
        table.extend(to_table(flags)?);
        let config: Self =
            table.try_into().map_err(|error: toml::de::Error| SettingsError::Merge(error.to_string()))?;
        config.validate()?;
        Ok(config)
    }

    fn validate(&self) -> Result<(), SettingsError> {
        let within = |setting, value: usize, least, most| {
            let value = value as u64;
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(SettingsError::Range { setting, value, least, most })
            }
        };
        within("workers", self.workers, 1, 256)?;
        within("threads", self.threads.unwrap_or(1), 1, 256)?;
        within("max_batch", self.max_batch, 1, 256)?;
        within("queue", self.queue, 1, 65_536)?;
        within("max_body_bytes", self.max_body_bytes, 1024, 1 << 30)?;
        within("queue_bytes", self.queue_bytes, 1024, 1 << 40)?;
        within("max_batch_images", self.max_batch_images, 1, 1024)?;
        let Self { timeout_ms, max_timeout_ms, queue_bytes, max_body_bytes, .. } = *self;
        for (setting, value, least, most) in [
            ("timeout_ms", timeout_ms, 1, 3_600_000),
            ("max_timeout_ms", max_timeout_ms, 1, 3_600_000),
            ("batch_delay_ms", self.batch_delay_ms, 0, 1000),
            ("drain_seconds", self.drain_seconds, 0, 3600),
        ] {
            if !(least..=most).contains(&value) {
                return Err(SettingsError::Range { setting, value, least, most });
            }
        }
        if queue_bytes < max_body_bytes {
            return Err(SettingsError::QueueBytes { queue_bytes, max_body_bytes });
        }
        if timeout_ms > max_timeout_ms {
            return Err(SettingsError::Timeout { timeout_ms, max_timeout_ms });
        }
        Ok(())
    }

    /// Threads for each network: stated, or the cores (of the container, if it has a quota) shared among the workers.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or_else(|| (available_cores() / self.workers).max(1))
    }

    pub(super) fn queue(&self) -> QueueConfig {
        QueueConfig {
            limit: self.queue,
            limit_bytes: self.queue_bytes,
            workers: self.workers,
            max_batch: self.max_batch,
            batch_delay: Duration::from_millis(self.batch_delay_ms),
            decode: DecodeOptions {
                max_side_px: self.max_side_px,
                max_pixels: self.max_pixels,
                exif_orientation: self.exif_orientation,
            },
        }
    }
}

/// Through [`Settings`], so that an unknown or misspelt setting is refused with its line.
fn read(text: &str, path: &Path) -> Result<toml::Table, SettingsError> {
    let settings: Settings =
        toml::from_str(text).map_err(|source| SettingsError::File { path: path.into(), source: Box::new(source) })?;
    to_table(&settings)
}

fn to_table(settings: &Settings) -> Result<toml::Table, SettingsError> {
    toml::Table::try_from(settings).map_err(|error| SettingsError::Merge(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_win_over_the_file_and_the_file_over_the_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("posed.toml");
        std::fs::write(&path, "queue = 5\nworkers = 2\n").unwrap();
        let flags = Settings { queue: Some(7), ..Settings::default() };
        let config = Config::new(&flags, Some(&path)).unwrap();
        assert_eq!((config.queue, config.workers, config.max_batch), (7, 2, 8));
    }

    #[test]
    fn impossible_settings_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("posed.toml");
        for (text, words) in [
            ("quue = 5", "quue"),
            ("queue = \"many\"", "queue"),
            ("queue = 0", "'queue' is 0"),
            ("queue_bytes = 2000", "max_body_bytes"),
            ("timeout_ms = 100000", "max_timeout_ms"),
            ("http = \"nowhere\"", "http"),
            ("provider = \"abacus\"", "abacus"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = Config::new(&Settings::default(), Some(&path)).unwrap_err().to_string();
            assert!(message.contains(words), "{text}: {message}");
        }
    }
}
