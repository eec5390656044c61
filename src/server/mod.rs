//! The server: front ends that translate, and the service that they all call.

mod admin;
pub mod api;
mod body;
mod connections;
mod descriptors;
mod front_end;
#[cfg(fuzzing)]
pub mod fuzzing;
mod grpc;
mod http;
mod log_filter;
mod log_line;
mod observe;
mod open;
mod pending;
mod run;
mod service;
mod settings;
mod settings_file;
mod stop;
mod telemetry;
mod tls;

pub use http::openapi;
pub use run::{ServeError, run};
pub use settings::{Config, LogFormat, SettingsError};
pub use settings_file::{SettingsFile, SettingsFileError, default_settings, unknown_variables};
pub use telemetry::{LogControl, init_logs};
pub use tls::TlsError;
