//! What a front end is. Each is a folder beside this file, and a line in [`FRONT_ENDS`](super::run).

use std::error::Error;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;

use axum::Router;
use tokio::sync::watch;

pub(super) use super::connections::Protocol;
use super::service::{Readiness, Service};
use super::settings::Config;

/// An address of its own, and what answers there.
pub(super) struct FrontEnd {
    /// As its setting is named.
    pub name: &'static str,
    pub protocol: Protocol,
    pub address: fn(&Config) -> SocketAddr,
    /// What all its open requests take at most, beside their bodies and connections.
    pub requests_bytes: u64,
    pub router: fn(Arc<Context>) -> Making,
}

/// A router on its way.
pub(super) type Making = Pin<Box<dyn Future<Output = Result<Router, Box<dyn Error + Send + Sync>>> + Send>>;

/// What a front end is made of.
pub(super) struct Context {
    pub service: Arc<Service>,
    pub readiness: Readiness,
    /// True once no further frame of a stream is read.
    pub stopping: watch::Receiver<bool>,
    /// Whether people get a page.
    pub page: bool,
}
