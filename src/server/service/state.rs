//! What serves until the end, and what is served now.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use thiserror::Error;

use super::access::Access;
use super::allowed_changes::AllowedChanges;
use super::cameras::{CameraFolderError, Cameras};
use super::limits::{Connections, Limits, Memory};
use super::metrics::Metrics;
use super::recent::Recent;
use super::watch;
use crate::estimator::{Estimator, Queue, StartError};
use crate::model::{Backend as _, Catalogue, Current, Library, LoadError, Provider, References, Runtime, StoreError};
use crate::server::settings::Config;

/// The loaded models with the queue before them, and what is counted of it.
pub(crate) struct Service {
    pub(super) queue: Queue,
    pub(super) current: Arc<Current>,
    /// Held by whoever changes what is served.
    pub(super) changing: Arc<tokio::sync::Mutex<()>>,
    pub(super) runtime: Arc<Runtime>,
    /// Where the models lie.
    pub(super) models: PathBuf,
    /// Whether changes there are served.
    pub(super) watch: bool,
    /// There where clients may change objects.
    pub(super) object_changes: Option<AllowedChanges>,
    pub(super) cameras: Cameras,
    pub(crate) provider: Provider,
    pub(crate) limits: Limits,
    pub(crate) memory: Memory,
    pub(crate) metrics: Metrics,
    pub(crate) access: Access,
    pub(super) recent: Recent,
    /// Turns of images that come in batches.
    pub(super) batch_turns: tokio::sync::Semaphore,
    /// There where clients may replace references. One at a time: two of one object would mix their images.
    pub(super) recalibration: Option<Arc<tokio::sync::Mutex<()>>>,
    /// The server is about to end: requests should go elsewhere, and are answered nevertheless.
    draining: AtomicBool,
}

/// A request at its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answered<'a> {
    pub protocol: &'static str,
    pub route: &'a str,
    /// Whether it asked for poses, and so is part of what `/v1/status` tells of the last minute.
    pub for_poses: bool,
    /// `ok`, or a failure's name.
    pub outcome: &'static str,
    pub duration: Duration,
}

/// Why there is nothing to serve.
#[derive(Debug, Error)]
pub(crate) enum LoadFailure {
    #[error(transparent)]
    Cameras(#[from] CameraFolderError),
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Start(#[from] StartError),
}

impl Service {
    /// Loads everything from disk and starts the workers, warmed up. `connections` is what the front ends' connections may
    /// take in all.
    pub(crate) fn load(config: &Config, connections: Connections, access: Access) -> Result<Self, LoadFailure> {
        let cameras = config.cameras.as_deref().map(Cameras::read).transpose()?.unwrap_or_default();
        let object_changes = config.object_changes.then(|| AllowedChanges::at(&config.models)).transpose()?;
        let may_be_empty = config.object_changes || config.watch;
        let load = if may_be_empty { Library::load_or_empty } else { Library::load };
        let library = Arc::new(load(&config.models)?.with_ok_probability(config.ok_probability));
        let references = Arc::new(References::load_usable(&config.reference, &library).map_err(LoadError::from)?);
        if config.recalibration {
            references.check_writable().map_err(LoadError::from)?;
        }
        tell_what_is_served(&library, &references);
        let runtime = Runtime::load(config.provider, 1).map_err(LoadError::from)?;
        let provider = runtime.provider();
        let config = &config.settled(provider);
        let runtime = Arc::new(runtime.with_threads(config.threads()));
        tracing::info!("provider: {provider}; workers: {}, of {} threads each", config.workers(), config.threads());
        let working_bytes = Estimator::working_bytes(&library, config.max_batch) * config.workers() as u64;
        let current = Arc::new(Current::new(Arc::new(Catalogue { library, references })));
        watch::references(&current);
        let of_workers = (Arc::clone(&current), Arc::clone(&runtime));
        let queue = Queue::start(config.queue(), move || Estimator::of(of_workers.0.get(), &*of_workers.1))?;
        let limits = Limits::new(config);
        let memory = Memory::new(config, working_bytes, connections);
        let metrics = Metrics::new(queue.clone(), memory.clone());
        metrics.models(&current.get().library, provider);
        let recalibration = config.recalibration.then(Arc::default);
        let (recent, batch_turns) = (Recent::default(), tokio::sync::Semaphore::new(limits.batch_places()));
        Ok(Self {
            queue,
            current,
            changing: Arc::default(),
            runtime,
            models: config.models.clone(),
            watch: config.watch,
            object_changes,
            cameras,
            provider,
            limits,
            memory,
            metrics,
            access,
            recent,
            batch_turns,
            recalibration,
            draining: AtomicBool::new(false),
        })
    }

    /// `Err` says why no request should come here now.
    pub(super) fn serves(&self) -> Result<(), &'static str> {
        if self.draining.load(Ordering::Relaxed) {
            return Err("shutting down");
        }
        if self.queue.stats().ready_workers.load(Ordering::Relaxed) == 0 {
            return Err("all workers have failed or hang; see the log");
        }
        let Catalogue { library, references } = &*self.catalogue();
        let mut objects = library.known();
        let may_come = self.recalibration.is_some() || self.object_changes.is_some() || self.watch;
        if !objects.any(|object| references.get(&object.manifest.name).is_some()) && !may_come {
            return Err("no object is calibrated; run `posed calibrate`");
        }
        Ok(())
    }

    /// All that is served now.
    pub(super) fn catalogue(&self) -> Arc<Catalogue> {
        self.current.get()
    }

    /// From now on it is not ready.
    pub(crate) fn set_draining(&self) {
        self.draining.store(true, Ordering::Relaxed);
    }

    /// What the process stays under, in the log.
    pub(crate) fn tell_bound(&self) {
        let memory = self.memory.bound();
        let mebibytes = |bytes: u64| bytes >> 20;
        let (bound, warm) = (mebibytes(memory.total_bytes()), mebibytes(memory.warm_bytes));
        tracing::info!("memory bound: {bound} MiB, of which {warm} MiB are in use now; see /v1/limits for its parts");
    }

    /// One more request is answered.
    pub(crate) fn answered(&self, request: &Answered<'_>) {
        let Answered { protocol, route, for_poses, outcome, duration } = *request;
        self.metrics.request(protocol, route, outcome, duration);
        if for_poses {
            self.recent.add(outcome, duration);
        }
    }
}

fn tell_what_is_served(library: &Library, references: &References) {
    for name in library.without_model() {
        tracing::warn!("object {name} is not available: it has no model folder");
    }
    for name in library.without_detector() {
        tracing::warn!("object {name} is not in the detector's labels: requests must send its box ('boxes')");
    }
    let is_calibrated = |name: &&str| references.get(name).is_some();
    let (calibrated, uncalibrated): (Vec<&str>, Vec<&str>) =
        library.known().map(|object| object.manifest.name.as_str()).partition(is_calibrated);
    for name in uncalibrated {
        let problem = references.problem(name);
        let problem = problem.unwrap_or_else(|| format!("it is not calibrated; run `posed calibrate {name}`"));
        tracing::warn!("object {name} is not available: {problem}");
    }
    tracing::info!("objects: {}", calibrated.join(", "));
}
