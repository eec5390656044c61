//! The server's life: ports, models, readiness, requests, and an end that loses none of them.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use thiserror::Error;
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::connections::{ConnectionLimits, Listener, Protocol};
use super::front_end::{Context, FrontEnd};
use super::service::{Access, AccessError, Connections, LoadFailure, Readiness, Service, watch_models};
use super::settings::Config;
use super::telemetry::LogControl;
use super::tls::{Tls, TlsError};
use super::{admin, descriptors, grpc, http, observe};

/// Every front end that clients see. A new one is a folder beside this file and a line here.
const FRONT_ENDS: [FrontEnd; 2] = [http::FRONT_END, grpc::FRONT_END];

/// Connections to the port for operators, which clients cannot use up.
const ADMIN_CONNECTIONS: usize = 16;
/// They are asked often, or not at all.
const ADMIN_IDLE: Duration = Duration::from_secs(5);

#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen for {protocol} on {address}: {source}; choose another address with --{protocol}")]
    Bind { protocol: &'static str, address: SocketAddr, source: std::io::Error },
    #[error("cannot wait for signals: {0}")]
    Signal(std::io::Error),
    #[error(transparent)]
    Tls(#[from] TlsError),
    #[error("{0}")]
    Load(String),
    #[error("loading the models failed; the log has the details")]
    Panicked,
    #[error("the {protocol} server cannot be built: {reason}")]
    FrontEnd { protocol: &'static str, reason: String },
}

impl From<AccessError> for ServeError {
    fn from(error: AccessError) -> Self {
        Self::Load(error.to_string())
    }
}

impl From<LoadFailure> for ServeError {
    fn from(failure: LoadFailure) -> Self {
        Self::Load(failure.to_string())
    }
}

/// Loads the models and serves them until SIGTERM or SIGINT, then finishes the accepted requests. A second signal exits at
/// once.
///
/// # Errors
/// When a port cannot be bound, a model cannot be loaded, or a server fails.
pub async fn run(config: Config, logs: LogControl) -> Result<(), ServeError> {
    let start = Instant::now();
    let mut signals = Signals::new().map_err(ServeError::Signal)?;
    let drain = Duration::from_secs(config.drain_seconds);
    let delay = Duration::from_millis(config.shutdown_delay_ms);
    let (stop, stopping) = watch::channel(false);
    let readiness = Readiness::default();
    let page = config.page;
    let access = Access::read(config.tokens.as_deref())?;
    let tls = config.tls_certificate.as_deref().zip(config.tls_key.as_deref());
    let tls = tls.map(|(certificate, key)| Tls::read(certificate, key)).transpose()?;
    // Every port before the models: one in use is known at once, and probes are answered while the models load.
    let limits = connection_limits(&config);
    let of_admin = ConnectionLimits { most: ADMIN_CONNECTIONS, idle: limits.idle.min(ADMIN_IDLE), ..limits };
    let admin = bind("admin", config.admin, of_admin)?;
    let mut listeners = Vec::with_capacity(FRONT_ENDS.len());
    for front_end in &FRONT_ENDS {
        listeners.push(bind(front_end.name, (front_end.address)(&config), limits)?);
    }
    // Ends with the program: probes are answered until then.
    let probes = admin::router(readiness.clone(), logs, access.clone());
    let (_never, until_the_end) = watch::channel(false);
    tokio::spawn(admin.serve(Protocol::Http1, None, probes, until_the_end));
    signals.reload_on_hangup(access.clone(), tls.clone());

    let encrypted = tls.is_some();
    let loading = tokio::task::spawn_blocking(move || Service::load(&config, connections(limits, encrypted), access));
    let service = tokio::select! {
        loaded = loading => Arc::new(loaded.map_err(|_| ServeError::Panicked)??),
        () = signals.next() => return Ok(()),
    };
    service.tell_bound();
    watch_models(&service);
    readiness.set_ready(Arc::clone(&service));
    let draining = Arc::clone(&service);
    let context = Arc::new(Context { service, readiness: readiness.clone(), stopping: stopping.clone(), page });
    let mut servers = JoinSet::new();
    for (front_end, listener) in FRONT_ENDS.iter().zip(listeners) {
        let built = (front_end.router)(Arc::clone(&context)).await;
        let failed = |error| ServeError::FrontEnd { protocol: front_end.name, reason: format!("{error}") };
        let router = observe::with_marks(built.map_err(failed)?);
        servers.spawn(listener.serve(front_end.protocol, tls.clone(), router, stopping.clone()));
    }
    tracing::info!("ready after {:.1} s", start.elapsed().as_secs_f64());

    signals.next().await;
    draining.set_draining();
    if !delay.is_zero() {
        tracing::info!("shutting down: not ready, taking requests for another {delay:?} ('shutdown_delay_ms')");
        tokio::select! {
            () = tokio::time::sleep(delay) => {}
            () = signals.next() => {
                tracing::warn!("second signal: exiting immediately");
                return Ok(());
            }
        }
    }
    tracing::info!("shutting down: finishing accepted requests");
    // All receivers are gone only when the servers have ended already.
    let _ = stop.send(true);
    tokio::select! {
        _ = servers.join_all() => tracing::info!("all accepted requests are answered"),
        () = signals.next() => tracing::warn!("second signal: exiting immediately"),
        () = tokio::time::sleep(drain) => {
            tracing::warn!("requests are still running after {drain:?} ('drain_seconds'): exiting");
        }
    }
    Ok(())
}

fn bind(protocol: &'static str, address: SocketAddr, limits: ConnectionLimits) -> Result<Listener, ServeError> {
    let failed = |source| ServeError::Bind { protocol, address, source };
    let listener = Listener::bind(protocol, address, limits).map_err(failed)?;
    tracing::info!("{protocol} on {}", listener.address().map_err(failed)?);
    Ok(listener)
}

fn connection_limits(config: &Config) -> ConnectionLimits {
    ConnectionLimits {
        most: descriptors::connections(config.max_connections, FRONT_ENDS.len(), ADMIN_CONNECTIONS),
        idle: Duration::from_millis(config.idle_timeout_ms),
        write: Duration::from_millis(config.write_timeout_ms),
    }
}

/// What all connections may take.
fn connections(limits: ConnectionLimits, tls: bool) -> Connections {
    let of_ports = FRONT_ENDS
        .iter()
        .map(|front_end| limits.most as u64 * front_end.protocol.connection_bytes(tls) + front_end.requests_bytes);
    Connections { bytes: of_ports.sum::<u64>() + ADMIN_CONNECTIONS as u64 * Protocol::Http1.connection_bytes(false) }
}

struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
    hangup: Option<tokio::signal::unix::Signal>,
}

impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hangup: Some(signal(SignalKind::hangup())?),
        })
    }

    /// Reads the tokens and the certificate again. A terminal that closes must not end the server.
    fn reload_on_hangup(&mut self, access: Access, tls: Option<Tls>) {
        let Some(mut hangup) = self.hangup.take() else { return };
        tokio::spawn(async move {
            while hangup.recv().await.is_some() {
                tracing::info!(
                    "SIGHUP: reading tokens and certificate again; other settings and models need a restart"
                );
                access.reload();
                if let Some(tls) = &tls {
                    tls.reload();
                }
            }
        });
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}
