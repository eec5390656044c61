use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tonic::transport::server::TcpIncoming;

use super::grpc::PoseServiceServer;
use super::{App, Cameras, grpc, http};
use crate::estimator::Queue;

/// Where and how to serve.
#[derive(Clone, Debug)]
pub struct Config {
    pub http: SocketAddr,
    pub grpc: SocketAddr,
    pub max_body_bytes: usize,
    /// After a shutdown signal, accepted requests have this long to finish.
    pub drain: Duration,
}

#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen for {protocol} on {address}: {source}; choose another address with --{protocol}")]
    Bind { protocol: &'static str, address: SocketAddr, source: std::io::Error },
    #[error("cannot wait for signals: {0}")]
    Signal(std::io::Error),
    #[error("the HTTP server failed: {0}")]
    Http(std::io::Error),
    #[error("the gRPC server failed: {0}")]
    Grpc(tonic::transport::Error),
}

/// Serves until SIGTERM or SIGINT, then finishes what was accepted. A second signal ends at once.
///
/// # Errors
/// When a port cannot be bound or a server fails.
pub async fn run(config: Config, queue: Queue, cameras: Cameras) -> Result<(), ServeError> {
    let app = App {
        queue,
        cameras: Arc::new(cameras),
        max_body_bytes: config.max_body_bytes,
        ready: Arc::new(AtomicBool::new(true)),
    };
    let http_listener = bind("http", config.http).await?;
    let grpc_listener = bind("grpc", config.grpc).await?;
    let mut signals = Signals::new().map_err(ServeError::Signal)?;
    let (stop, stopping) = watch::channel(false);

    let router = http::router(app.clone());
    let http_server = axum::serve(http_listener, router).with_graceful_shutdown(stopped(stopping.clone()));
    let http_server = tokio::spawn(async move { http_server.await.map_err(ServeError::Http) });
    let (health, health_service) = tonic_health::server::health_reporter();
    health.set_serving::<PoseServiceServer<grpc::Service>>().await;
    let grpc_server = tonic::transport::Server::builder()
        .add_service(health_service)
        .add_service(grpc::service(app.clone()))
        .serve_with_incoming_shutdown(TcpIncoming::from(grpc_listener), stopped(stopping));
    let grpc_server = tokio::spawn(async move { grpc_server.await.map_err(ServeError::Grpc) });

    let servers = async { tokio::join!(http_server, grpc_server) };
    tokio::pin!(servers);
    tokio::select! {
        // Without a signal a server ends only by failing.
        results = &mut servers => return both(results),
        () = signals.next() => {}
    }
    tracing::info!("shutting down: finishing accepted requests");
    app.ready.store(false, Ordering::Relaxed);
    health.set_not_serving::<PoseServiceServer<grpc::Service>>().await;
    // Both are gone only when their servers have ended already.
    let _ = stop.send(true);
    tokio::select! {
        results = &mut servers => both(results),
        () = signals.next() => {
            tracing::warn!("second signal: ending at once");
            Ok(())
        }
        () = tokio::time::sleep(config.drain) => {
            tracing::warn!("requests were still running after {:?}", config.drain);
            Ok(())
        }
    }
}

async fn bind(protocol: &'static str, address: SocketAddr) -> Result<TcpListener, ServeError> {
    let failed = |source| ServeError::Bind { protocol, address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    tracing::info!("{protocol} on {}", listener.local_addr().map_err(failed)?);
    Ok(listener)
}

async fn stopped(mut stopping: watch::Receiver<bool>) {
    // An error means that the sender is gone, and so is the program.
    let _ = stopping.wait_for(|stop| *stop).await;
}

type Ended = Result<Result<(), ServeError>, tokio::task::JoinError>;

fn both((http, grpc): (Ended, Ended)) -> Result<(), ServeError> {
    for ended in [http, grpc] {
        match ended {
            Ok(result) => result?,
            Err(panicked) => std::panic::resume_unwind(panicked.into_panic()),
        }
    }
    Ok(())
}

struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
}

impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}
