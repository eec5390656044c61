use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tonic::transport::server::TcpIncoming;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use super::admin::{self, Admin};
use super::grpc::PoseServiceServer;
use super::metrics::Metrics;
use super::telemetry::LogControl;
use super::{App, CameraError, Cameras, Config, Shared, grpc, http};
use crate::estimator::{Estimator, Queue, StartError};
use crate::model::{Backend, Library, LoadError, ModelsInUse, References, Runtime};
use crate::proto;

#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen for {protocol} on {address}: {source}; choose another address with --{protocol}")]
    Bind { protocol: &'static str, address: SocketAddr, source: std::io::Error },
    #[error("cannot wait for signals: {0}")]
    Signal(std::io::Error),
    #[error(transparent)]
    Cameras(#[from] CameraError),
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error("loading the models panicked")]
    Panicked,
    #[error("the reflection service cannot be built: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    #[error("the {protocol} server failed: {reason}")]
    Server { protocol: &'static str, reason: String },
}

/// How often the gRPC health service is told what the probes know.
const HEALTH_INTERVAL: Duration = Duration::from_millis(500);

/// Loads the models and serves them until SIGTERM or SIGINT, then finishes what was accepted. A second signal ends at once.
///
/// # Errors
/// When a port cannot be bound, a model cannot be loaded, or a server fails.
pub async fn run(config: Config, logs: LogControl) -> Result<(), ServeError> {
    let start = Instant::now();
    let mut signals = Signals::new().map_err(ServeError::Signal)?;
    let drain = Duration::from_secs(config.drain_seconds);
    // Every port before the models: one in use is known at once, and probes are answered while the models load.
    let admin_listener = bind("admin", config.admin).await?;
    let http_listener = bind("http", config.http).await?;
    let grpc_listener = bind("grpc", config.grpc).await?;
    let admin = Admin::new(logs);
    let (stop, stopping) = watch::channel(false);
    let admin_server = axum::serve(admin_listener, admin::router(admin.clone())).into_future();
    // Ends with the program: probes are answered until then.
    tokio::spawn(admin_server);

    let loading = tokio::task::spawn_blocking(move || load(config));
    let app = tokio::select! {
        loaded = loading => loaded.map_err(|_| ServeError::Panicked)??,
        () = signals.next() => return Ok(()),
    };
    let http = axum::serve(http_listener, http::router(app.clone())).with_graceful_shutdown(stopped(stopping.clone()));
    let http = tokio::spawn(async move { http.await.map_err(|error| failed("HTTP", &error)) });
    admin.set_ready(app.clone());
    let grpc = serve_grpc(&app, &admin, grpc_listener, stopping).await?;
    tracing::info!("ready after {:.1} s", start.elapsed().as_secs_f64());

    let servers = async { tokio::try_join!(flat(http), flat(grpc)) };
    tokio::pin!(servers);
    tokio::select! {
        // Without a signal a server ends only by failing.
        results = &mut servers => return results.map(drop),
        () = signals.next() => {}
    }
    tracing::info!("shutting down: finishing accepted requests");
    admin.set_draining();
    // All receivers are gone only when the servers have ended already.
    let _ = stop.send(true);
    tokio::select! {
        results = &mut servers => {
            tracing::info!("every accepted request is answered");
            results.map(drop)
        }
        () = signals.next() => {
            tracing::warn!("second signal: ending at once");
            Ok(())
        }
        () = tokio::time::sleep(drain) => {
            tracing::warn!("requests were still running after {drain:?} ('drain_seconds')");
            Ok(())
        }
    }
}

/// Everything from disk, and the workers, warmed up.
fn load(config: Config) -> Result<App, ServeError> {
    let cameras = config.cameras.as_deref().map(Cameras::read).transpose()?.unwrap_or_default();
    let library = Arc::new(Library::load(&config.models)?);
    let references = Arc::new(References::load(&config.reference, &library).map_err(LoadError::from)?);
    for name in library.without_model() {
        tracing::warn!("{name} is not served: it has no model folder");
    }
    let is_calibrated = |name: &&str| references.get(name).is_some();
    let (calibrated, uncalibrated): (Vec<&str>, Vec<&str>) =
        library.known().map(|object| object.manifest.name.as_str()).partition(is_calibrated);
    for name in uncalibrated {
        tracing::warn!("{name} is not served: it is not calibrated (`posed calibrate {name}`)");
    }
    tracing::info!("objects: {}; provider: {}", calibrated.join(", "), config.provider);
    let runtime = Runtime::load(config.provider, config.threads()).map_err(LoadError::from)?;
    let models = ModelsInUse::new(&library, runtime.provider());
    let (of_workers, references_of_workers) = (Arc::clone(&library), Arc::clone(&references));
    let make = move || Estimator::new(Arc::clone(&of_workers), Arc::clone(&references_of_workers), &runtime);
    let queue = Queue::start(config.queue(), make)?;
    let metrics = Metrics::new(queue.clone(), &models);
    let recalibrating = tokio::sync::Mutex::new(());
    let app = Shared { queue, library, references, cameras, models, config, metrics, recalibrating };
    Ok(Arc::new(app))
}

type Ending = tokio::task::JoinHandle<Result<(), ServeError>>;

async fn serve_grpc(
    app: &App,
    admin: &Admin,
    listener: TcpListener,
    stopping: watch::Receiver<bool>,
) -> Result<Ending, ServeError> {
    let (health, health_service) = tonic_health::server::health_reporter();
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(proto::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()?;
    let server = tonic::transport::Server::builder()
        .add_service(health_service)
        .add_service(reflection)
        .add_service(grpc::service(app.clone(), stopping.clone()))
        .serve_with_incoming_shutdown(TcpIncoming::from(listener), stopped(stopping));
    // Before the first call can ask: else it may hear of a service that is not up for as long as HEALTH_INTERVAL.
    report_health(admin, &health).await;
    tokio::spawn(keep_reporting_health(admin.clone(), health));
    Ok(tokio::spawn(async move { server.await.map_err(|error| failed("gRPC", &error)) }))
}

/// Keeps the gRPC health service at what the probes say, until the program ends.
async fn keep_reporting_health(admin: Admin, health: HealthReporter) {
    loop {
        tokio::time::sleep(HEALTH_INTERVAL).await;
        report_health(&admin, &health).await;
    }
}

async fn report_health(admin: &Admin, health: &HealthReporter) {
    let status = if admin.readiness().is_ok() { ServingStatus::Serving } else { ServingStatus::NotServing };
    let name = <PoseServiceServer<grpc::Service> as tonic::server::NamedService>::NAME;
    for service in ["", name] {
        health.set_service_status(service, status).await;
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

fn failed(protocol: &'static str, error: &dyn std::error::Error) -> ServeError {
    ServeError::Server { protocol, reason: error.to_string() }
}

/// A server's own result, whether it failed or panicked.
async fn flat(ending: Ending) -> Result<(), ServeError> {
    match ending.await {
        Ok(result) => result,
        Err(panicked) => std::panic::resume_unwind(panicked.into_panic()),
    }
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
