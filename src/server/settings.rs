//! The settings of `posed serve`. Each is declared once, below. Its flag, its environment variable, its line in the
//! file, its default, its range and its explanation all follow from the declaration.

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgAction, Args, ValueEnum};
use thiserror::Error;

use crate::estimator::{QueueConfig, Room};
use crate::model::{Provider, ProviderSetting, Trust, available_cores};
use crate::vision::{DecodeOptions, OrientationPolicy};

const LISTEN: &str = "Where to listen";
const MODELS: &str = "What to serve";
const RUN: &str = "What to run on";
const LIMITS: &str = "Limits";
const TIMES: &str = "Times";
const SAFETY: &str = "Who may connect";
const LOGS: &str = "Logs";

/// Memory that the largest image must be able to use, for each of its pixels.
const BYTES_PER_PIXEL: u64 = 16;

/// By default: each takes memory of its own.
const MOST_WORKERS: usize = 4;

/// The settings. Their comments are the texts of `--help` and `--print-config`.
#[derive(Args, Clone, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "settings, each for itself")]
pub struct Config {
    /// Address of the HTTP API. `[::]` is every interface, IPv4 and IPv6; IPv4 alone where the system has no IPv6.
    #[arg(long, env = "POSED_HTTP", default_value = "[::]:8080", help_heading = LISTEN)]
    pub http: SocketAddr,
    /// Address of the gRPC API.
    #[arg(long, env = "POSED_GRPC", default_value = "[::]:9000", help_heading = LISTEN)]
    pub grpc: SocketAddr,
    /// Address of probes, metrics and the log level. For operators, not for clients: only this machine, unless you change it.
    #[arg(long, env = "POSED_ADMIN", default_value = "127.0.0.1:8081", help_heading = LISTEN)]
    pub admin: SocketAddr,
    /// Serve the page for people at `/` of the HTTP address.
    #[arg(long, env = "POSED_PAGE", help_heading = LISTEN)]
    #[arg(default_value_t = true, num_args = 0..=1, default_missing_value = "true", action = ArgAction::Set)]
    pub page: bool,
    /// Folder with one folder for each object, and `detector/` if objects share one.
    #[arg(long, env = "POSED_MODELS", default_value = "models", help_heading = MODELS)]
    pub models: PathBuf,
    /// Folder with the reference `<object>.json` of each calibrated object.
    #[arg(long, env = "POSED_REFERENCE", default_value = "reference", help_heading = MODELS)]
    pub reference: PathBuf,
    /// Folder of registered cameras. The file `left.camera.json` registers camera `left`.
    #[arg(long, env = "POSED_CAMERAS", help_heading = MODELS)]
    pub cameras: Option<PathBuf>,
    /// Allow clients to replace references with `PUT /v1/objects/{name}/reference`.
    #[arg(long, env = "POSED_RECALIBRATION", help_heading = MODELS)]
    #[arg(default_value_t = false, num_args = 0..=1, default_missing_value = "true", action = ArgAction::Set)]
    pub recalibration: bool,
    /// Allow clients to add, replace and remove objects with `PUT` and `DELETE /v1/objects/{name}`. The models folder must be
    /// writable.
    #[arg(long, env = "POSED_OBJECT_CHANGES", help_heading = MODELS)]
    #[arg(default_value_t = false, num_args = 0..=1, default_missing_value = "true", action = ArgAction::Set)]
    pub object_changes: bool,
    /// Look for changes in the models folder every two seconds, and serve what was added, replaced or removed there.
    #[arg(long, env = "POSED_WATCH", help_heading = MODELS)]
    #[arg(default_value_t = false, num_args = 0..=1, default_missing_value = "true", action = ArgAction::Set)]
    pub watch: bool,
    /// Probability from which on a pose is `ok`, 0..1, of objects whose models state probabilities. Omit this to use what they
    /// state.
    #[arg(long, env = "POSED_OK_PROBABILITY", value_parser = Trust::parse_probability, help_heading = MODELS)]
    pub ok_probability: Option<f64>,
    /// How to treat an image with an EXIF orientation.
    #[arg(long, env = "POSED_EXIF_ORIENTATION", value_enum, default_value_t, help_heading = MODELS)]
    pub exif_orientation: OrientationPolicy,
    /// Execution provider of the networks. cuda and tensorrt need an ONNX Runtime library built with it.
    #[arg(long, env = "POSED_PROVIDER", value_enum, default_value_t, help_heading = RUN)]
    pub provider: ProviderSetting,
    /// Number of workers. Each worker has its own networks. Omit this to have one; with OpenVINO, one for each core, four at most.
    #[arg(long, env = "POSED_WORKERS", value_parser = whole::<usize>(1..=256), help_heading = RUN)]
    pub workers: Option<usize>,
    /// Threads for each network. Omit this to share the available cores among the workers; with OpenVINO, to have one.
    #[arg(long, env = "POSED_THREADS", value_parser = whole::<usize>(1..=256), help_heading = RUN)]
    pub threads: Option<usize>,
    /// Maximum number of images that a worker processes together.
    #[arg(long, env = "POSED_MAX_BATCH", help_heading = RUN)]
    #[arg(default_value_t = 2, value_parser = whole::<usize>(1..=256))]
    pub max_batch: usize,
    /// Time that a worker waits for further images to process together, milliseconds.
    #[arg(long, env = "POSED_BATCH_DELAY_MS", help_heading = RUN)]
    #[arg(default_value_t = 0, value_parser = whole::<u64>(0..=1000))]
    pub batch_delay_ms: u64,
    /// Maximum number of images that are decoded at the same time.
    #[arg(long, env = "POSED_DECODERS", default_value_t = 2, value_parser = whole::<usize>(1..=64), help_heading = RUN)]
    pub decoders: usize,
    /// Maximum number of images that are waiting or in progress. Further images get 429 or `RESOURCE_EXHAUSTED`.
    #[arg(long, env = "POSED_QUEUE", help_heading = LIMITS)]
    #[arg(default_value_t = 16, value_parser = whole::<usize>(1..=65_536))]
    pub queue: usize,
    /// Maximum size of all request bodies together, bytes. A body counts until its answer has left.
    #[arg(long, env = "POSED_QUEUE_BYTES", help_heading = LIMITS)]
    #[arg(default_value_t = 134_217_728, value_parser = whole::<usize>(1024..=1 << 40))]
    pub queue_bytes: usize,
    /// Maximum memory for decoded images and for decoding, bytes. An image counts until it is answered.
    #[arg(long, env = "POSED_PIXEL_BYTES", help_heading = LIMITS)]
    #[arg(default_value_t = 402_653_184, value_parser = whole::<usize>(4096..=1 << 40))]
    pub pixel_bytes: usize,
    /// Maximum size of a request body or gRPC message, bytes.
    #[arg(long, env = "POSED_MAX_BODY_BYTES", help_heading = LIMITS)]
    #[arg(default_value_t = 16_777_216, value_parser = whole::<usize>(1024..=1 << 30))]
    pub max_body_bytes: usize,
    /// Maximum size of the bundle of an object, bytes.
    #[arg(long, env = "POSED_MAX_BUNDLE_BYTES", help_heading = LIMITS)]
    #[arg(default_value_t = 134_217_728, value_parser = whole::<usize>(1024..=1 << 32))]
    pub max_bundle_bytes: usize,
    /// Maximum width and height of an image, pixels.
    #[arg(long, env = "POSED_MAX_SIDE_PX", help_heading = LIMITS)]
    #[arg(default_value_t = DecodeOptions::default().max_side_px, value_parser = whole::<u32>(16..=u32::MAX.into()))]
    pub max_side_px: u32,
    /// Maximum number of pixels of an image.
    #[arg(long, env = "POSED_MAX_PIXELS", help_heading = LIMITS)]
    #[arg(default_value_t = DecodeOptions::default().max_pixels, value_parser = whole::<u64>(256..=1 << 36))]
    pub max_pixels: u64,
    /// Maximum number of images in a request to `/v1/poses/batch`.
    #[arg(long, env = "POSED_MAX_BATCH_IMAGES", help_heading = LIMITS)]
    #[arg(default_value_t = 16, value_parser = whole::<usize>(1..=1024))]
    pub max_batch_images: usize,
    /// Maximum number of images in a request to `/v1/poses/views`.
    #[arg(long, env = "POSED_MAX_VIEWS", help_heading = LIMITS)]
    #[arg(default_value_t = 16, value_parser = whole::<usize>(2..=64))]
    pub max_views: usize,
    /// Maximum number of open connections on each of the HTTP and gRPC ports. Further connections wait.
    #[arg(long, env = "POSED_MAX_CONNECTIONS", help_heading = LIMITS)]
    #[arg(default_value_t = 256, value_parser = whole::<usize>(8..=65_536))]
    pub max_connections: usize,
    /// Default time limit of a request, milliseconds.
    #[arg(long, env = "POSED_TIMEOUT_MS", help_heading = TIMES)]
    #[arg(default_value_t = 10_000, value_parser = whole::<u64>(100..=3_600_000))]
    pub timeout_ms: u64,
    /// Maximum time limit that a request can set, milliseconds.
    #[arg(long, env = "POSED_MAX_TIMEOUT_MS", help_heading = TIMES)]
    #[arg(default_value_t = 60_000, value_parser = whole::<u64>(100..=3_600_000))]
    pub max_timeout_ms: u64,
    /// Maximum pause while a client sends a body, milliseconds. After it the request fails.
    #[arg(long, env = "POSED_BODY_TIMEOUT_MS", help_heading = TIMES)]
    #[arg(default_value_t = 3000, value_parser = whole::<u64>(100..=600_000))]
    pub body_timeout_ms: u64,
    /// Maximum pause while a client reads an answer, milliseconds. After it the connection closes.
    #[arg(long, env = "POSED_WRITE_TIMEOUT_MS", help_heading = TIMES)]
    #[arg(default_value_t = 10_000, value_parser = whole::<u64>(100..=600_000))]
    pub write_timeout_ms: u64,
    /// Maximum time to wait for the headers of a connection's next request, or for the answer to a ping, milliseconds.
    /// After it the connection closes.
    #[arg(long, env = "POSED_IDLE_TIMEOUT_MS", help_heading = TIMES)]
    #[arg(default_value_t = 30_000, value_parser = whole::<u64>(100..=3_600_000))]
    pub idle_timeout_ms: u64,
    /// Maximum time that a worker may take for its images, milliseconds. After it the worker is taken out until it comes back.
    #[arg(long, env = "POSED_WORKER_TIMEOUT_MS", help_heading = TIMES)]
    #[arg(default_value_t = 30_000, value_parser = whole::<u64>(1000..=3_600_000))]
    pub worker_timeout_ms: u64,
    /// Time after a shutdown signal during which the server is not ready but still takes requests, milliseconds. Set it to
    /// what your load balancer needs to notice.
    #[arg(long, env = "POSED_SHUTDOWN_DELAY_MS", help_heading = TIMES)]
    #[arg(default_value_t = 0, value_parser = whole::<u64>(0..=3_600_000))]
    pub shutdown_delay_ms: u64,
    /// Time for accepted requests to finish after a shutdown signal, seconds.
    #[arg(long, env = "POSED_DRAIN_SECONDS", help_heading = TIMES)]
    #[arg(default_value_t = 10, value_parser = whole::<u64>(0..=3600))]
    pub drain_seconds: u64,
    /// File of bearer tokens. Each line has the SHA-256 of a token and its scopes: estimate, calibrate, objects, admin. Without it
    /// everybody may do everything.
    #[arg(long, env = "POSED_TOKENS", help_heading = SAFETY)]
    pub tokens: Option<PathBuf>,
    /// Certificate chain of the HTTP and gRPC ports, a PEM file. Without it they do not use TLS.
    #[arg(long, env = "POSED_TLS_CERTIFICATE", help_heading = SAFETY)]
    pub tls_certificate: Option<PathBuf>,
    /// Private key of the certificate, a PEM file.
    #[arg(long, env = "POSED_TLS_KEY", help_heading = SAFETY)]
    pub tls_key: Option<PathBuf>,
    /// Log level, or a filter such as "info,posed=debug".
    #[arg(long, env = "POSED_LOG", default_value = "info,ort=warn", help_heading = LOGS)]
    pub log: String,
    /// Format of log lines.
    #[arg(long, env = "POSED_LOG_FORMAT", value_enum, default_value_t, help_heading = LOGS)]
    pub log_format: LogFormat,
}

/// Format of log lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    #[default]
    Pretty,
    Json,
}

/// Settings that are valid one by one, but not together.
#[derive(Debug, Error)]
pub enum SettingsError {
    #[error(
        "setting 'queue_bytes' is {queue_bytes}, but the largest body ('max_body_bytes', {max_body_bytes}) needs at least \
         {least}; raise 'queue_bytes', or lower 'max_body_bytes'"
    )]
    QueueBytes { queue_bytes: usize, max_body_bytes: usize, least: usize },
    #[error(
        "setting 'timeout_ms' is {timeout_ms}, but the maximum is {max_timeout_ms} ('max_timeout_ms'); lower \
         'timeout_ms', or raise 'max_timeout_ms'"
    )]
    Timeout { timeout_ms: u64, max_timeout_ms: u64 },
    #[error(
        "setting 'pixel_bytes' is {pixel_bytes}, but the largest image ('max_pixels', {max_pixels}) needs at least \
         {least}; raise 'pixel_bytes', or lower 'max_pixels'"
    )]
    PixelBytes { pixel_bytes: usize, max_pixels: u64, least: u64 },
    #[error("setting '{given}' is set, but '{missing}' is not; TLS needs both")]
    Tls { given: &'static str, missing: &'static str },
}

impl Config {
    /// Checks settings that depend on each other.
    ///
    /// # Errors
    /// When two settings contradict each other, with both names.
    pub fn check(&self) -> Result<(), SettingsError> {
        let Self { queue_bytes, max_body_bytes, timeout_ms, max_timeout_ms, pixel_bytes, max_pixels, .. } = *self;
        let least = Room::least_bytes(max_body_bytes);
        if queue_bytes < least {
            return Err(SettingsError::QueueBytes { queue_bytes, max_body_bytes, least });
        }
        if timeout_ms > max_timeout_ms {
            return Err(SettingsError::Timeout { timeout_ms, max_timeout_ms });
        }
        match (&self.tls_certificate, &self.tls_key) {
            (Some(_), None) => return Err(SettingsError::Tls { given: "tls_certificate", missing: "tls_key" }),
            (None, Some(_)) => return Err(SettingsError::Tls { given: "tls_key", missing: "tls_certificate" }),
            (Some(_), Some(_)) | (None, None) => {}
        }
        let least = BYTES_PER_PIXEL * max_pixels;
        if (pixel_bytes as u64) < least {
            return Err(SettingsError::PixelBytes { pixel_bytes, max_pixels, least });
        }
        Ok(())
    }

    /// With the workers and threads that are fastest on this provider (docs/design.md), where none are set.
    #[must_use]
    pub fn settled(&self, provider: Provider) -> Self {
        let many = provider.prefers_workers();
        let workers = self.workers.unwrap_or_else(|| if many { available_cores().min(MOST_WORKERS) } else { 1 });
        let threads = self.threads.unwrap_or_else(|| if many { 1 } else { (available_cores() / workers).max(1) });
        Self { workers: Some(workers), threads: Some(threads), ..self.clone() }
    }

    /// As set or settled.
    #[must_use]
    pub fn workers(&self) -> usize {
        self.workers.unwrap_or(1)
    }

    /// For each network, as set or settled.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or(1)
    }

    pub(super) fn queue(&self) -> QueueConfig {
        QueueConfig {
            room: Room { images: self.queue, bytes: self.queue_bytes, pixel_bytes: self.pixel_bytes },
            decoders: self.decoders,
            workers: self.workers(),
            max_batch: self.max_batch,
            batch_delay: Duration::from_millis(self.batch_delay_ms),
            worker_timeout: Duration::from_millis(self.worker_timeout_ms),
            decode: DecodeOptions {
                max_side_px: self.max_side_px,
                max_pixels: self.max_pixels,
                exif_orientation: self.exif_orientation,
            },
        }
    }
}

/// Reads a whole number within a range. Every error states the range.
fn whole<T: TryFrom<u64>>(range: RangeInclusive<u64>) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        let refusal = || format!("it must be a whole number from {} to {}", range.start(), range.end());
        number.and_then(|number| T::try_from(number).ok()).ok_or_else(refusal)
    }
}

#[cfg(test)]
mod tests {
    use clap::{Command, FromArgMatches as _};

    use super::*;

    fn command() -> Command {
        Config::augment_args(Command::new("posed").no_binary_name(true))
    }

    fn read(flags: &[&str]) -> Config {
        Config::from_arg_matches(&command().get_matches_from(flags)).unwrap()
    }

    #[test]
    fn the_defaults_are_possible() {
        command().debug_assert();
        read(&[]).check().unwrap();
    }

    #[test]
    fn a_setting_has_one_name_everywhere() {
        for argument in command().get_arguments() {
            let name = argument.get_id().as_str();
            assert_eq!(argument.get_long().unwrap(), name.replace('_', "-"));
            assert_eq!(argument.get_env().unwrap().to_str().unwrap(), format!("POSED_{}", name.to_uppercase()));
            assert!(argument.get_help().is_some() && argument.get_help_heading().is_some(), "{name}");
        }
    }

    #[test]
    fn recalibration_is_allowed_in_a_word() {
        for (flags, allowed) in [
            (&[][..], false),
            (&["--recalibration"], true),
            (&["--recalibration", "true"], true),
            (&["--recalibration", "false"], false),
        ] {
            assert_eq!(read(flags).recalibration, allowed, "{flags:?}");
        }
    }

    #[test]
    fn impossible_values_are_refused_with_what_is_allowed() {
        for (flag, words) in [
            ("--queue=0", "'0' for '--queue <QUEUE>': it must be a whole number from 1 to 65536"),
            ("--queue=many", "'many' for '--queue <QUEUE>': it must be a whole number from 1 to 65536"),
            ("--decoders=-1", "'-1' for '--decoders <DECODERS>': it must be a whole number from 1 to 64"),
            ("--max-side-px=15", "from 16 to 4294967295"),
            ("--max-side-px=4294967296", "from 16 to 4294967295"),
            ("--max-pixels=255", "from 256 to"),
            ("--timeout-ms=1", "from 100 to 3600000"),
            ("--worker-timeout-ms=1", "from 1000 to 3600000"),
            ("--max-connections=7", "from 8 to 65536"),
            ("--idle-timeout-ms=3600001", "from 100 to 3600000"),
            ("--provider=abacus", "auto, cpu, openvino, cuda, tensorrt"),
            ("--recalibration=maybe", "true, false"),
        ] {
            let message = command().try_get_matches_from([flag]).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn settings_that_contradict_each_other_are_refused_by_name() {
        for (flags, words) in [
            (&["--queue-bytes=2000"][..], ["'queue_bytes' is 2000", "'max_body_bytes', 16777216"]),
            (&["--tls-key=key.pem"], ["'tls_key' is set", "'tls_certificate' is not"]),
            (&["--timeout-ms=100000"], ["'timeout_ms' is 100000", "60000 ('max_timeout_ms')"]),
            (
                &["--pixel-bytes=15999", "--max-pixels=1000"],
                ["'pixel_bytes' is 15999", "('max_pixels', 1000) needs at least 16000"],
            ),
        ] {
            let message = read(flags).check().unwrap_err().to_string();
            assert!(words.iter().all(|words| message.contains(words)), "{message}");
        }
        read(&["--pixel-bytes=16000", "--max-pixels=1000"]).check().unwrap();
    }
}
