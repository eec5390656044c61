//! Logs: their form, and their level at run time.

use std::io::IsTerminal as _;

use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Registry, fmt, reload};

use super::log_filter;
use super::log_line::Lines;
use super::settings::LogFormat;

/// Changes the log's filter while the program runs.
#[derive(Clone)]
pub struct LogControl(reload::Handle<EnvFilter, Registry>);

impl LogControl {
    /// # Errors
    /// When the text is no filter: the old one stays.
    pub fn set(&self, filter: &str) -> Result<(), String> {
        self.0.reload(log_filter::parse(filter)?).map_err(|error| error.to_string())
    }
}

/// Starts logging to stderr. Called once, by the program.
///
/// # Errors
/// When the filter is none, or logging has been started before.
pub fn init_logs(filter: &str, format: LogFormat) -> Result<LogControl, String> {
    let filter = log_filter::parse(filter).map_err(|error| format!("setting 'log' is {filter:?}: {error}"))?;
    let (filter, handle) = reload::Layer::new(filter);
    let registry = tracing_subscriber::registry().with(filter);
    match format {
        LogFormat::Pretty => {
            let ansi = std::io::stderr().is_terminal();
            registry.with(fmt::layer().with_ansi(ansi).with_writer(Lines { format })).try_init()
        }
        LogFormat::Json => {
            registry.with(fmt::layer().json().flatten_event(true).with_writer(Lines { format })).try_init()
        }
    }
    .map_err(|error| error.to_string())?;
    Ok(LogControl(handle))
}
