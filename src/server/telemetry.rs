//! Logs: their form, and their level at run time.

use std::io::IsTerminal as _;

use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Registry, fmt, reload};

use super::settings::LogFormat;

/// Changes the log's filter while the program runs.
#[derive(Clone)]
pub struct LogControl(reload::Handle<EnvFilter, Registry>);

impl LogControl {
    /// # Errors
    /// When the text is no filter: the old one stays.
    pub fn set(&self, filter: &str) -> Result<(), String> {
        let filter = EnvFilter::try_new(filter).map_err(|error| format!("{filter:?} is not a log filter: {error}"))?;
        self.0.reload(filter).map_err(|error| error.to_string())
    }
}

/// Starts logging to stderr. Called once, by the program.
///
/// # Errors
/// When the filter is none, or logging has been started before.
pub fn init_logs(filter: &str, format: LogFormat) -> Result<LogControl, String> {
    let filter = EnvFilter::try_new(filter).map_err(|error| format!("setting 'log' is {filter:?}: {error}"))?;
    let (filter, handle) = reload::Layer::new(filter);
    let registry = tracing_subscriber::registry().with(filter);
    match format {
        LogFormat::Pretty => registry
            .with(fmt::layer().with_ansi(std::io::stderr().is_terminal()).with_writer(std::io::stderr))
            .try_init(),
        LogFormat::Json => {
            registry.with(fmt::layer().json().flatten_event(true).with_writer(std::io::stderr)).try_init()
        }
    }
    .map_err(|error| error.to_string())?;
    Ok(LogControl(handle))
}
