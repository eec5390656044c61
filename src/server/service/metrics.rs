//! What operators watch, in Prometheus' text format.

use std::sync::atomic::Ordering;
use std::time::Duration;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeLabelSet, EncodeMetric, text};
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};

use super::limits::Memory;
use super::memory::resident_bytes;
use crate::estimator::{Answer, Queue};
use crate::model::{Library, Provider};

#[derive(Clone, Debug, EncodeLabelSet, Hash, PartialEq, Eq)]
struct RequestLabels {
    protocol: &'static str,
    route: String,
    outcome: &'static str,
}

#[derive(Clone, Debug, EncodeLabelSet, Hash, PartialEq, Eq)]
struct RouteLabels {
    protocol: &'static str,
    route: String,
}

#[derive(Clone, Debug, EncodeLabelSet, Hash, PartialEq, Eq)]
struct StageLabels {
    stage: &'static str,
}

#[derive(Clone, Debug, EncodeLabelSet, Hash, PartialEq, Eq)]
struct ObjectLabels {
    object: String,
    status: String,
}

#[derive(Clone, Debug, EncodeLabelSet, Hash, PartialEq, Eq)]
struct ModelLabels {
    model: String,
    sha256: String,
    provider: String,
}

const SECONDS: [f64; 14] = [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0];
const PIXELS: [f64; 8] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
const IMAGES: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

type Histograms<L> = Family<L, Histogram, fn() -> Histogram>;

/// Every metric; labels are bounded by routes, outcomes and objects.
pub(crate) struct Metrics {
    registry: Registry,
    requests: Family<RequestLabels, Counter>,
    durations: Histograms<RouteLabels>,
    stages: Histograms<StageLabels>,
    objects: Family<ObjectLabels, Counter>,
    reprojection: Histogram,
    batch_size: Histogram,
    models: Family<ModelLabels, Gauge>,
}

impl Metrics {
    pub(crate) fn new(queue: Queue, memory: Memory) -> Self {
        let seconds: fn() -> Histogram = || Histogram::new(SECONDS);
        let mut metrics = Self {
            registry: Registry::with_prefix("posed"),
            requests: Family::default(),
            durations: Family::new_with_constructor(seconds),
            stages: Family::new_with_constructor(seconds),
            objects: Family::default(),
            reprojection: Histogram::new(PIXELS),
            batch_size: Histogram::new(IMAGES),
            models: Family::default(),
        };
        let registry = &mut metrics.registry;
        registry.register("requests", "Answered requests", metrics.requests.clone());
        let help = "Time from the arrival of a request to its answer";
        registry.register_with_unit("request_duration", help, Unit::Seconds, metrics.durations.clone());
        let help = "Time that an image spends in each stage";
        registry.register_with_unit("stage_duration", help, Unit::Seconds, metrics.stages.clone());
        registry.register("objects", "Detected objects by the status of their poses", metrics.objects.clone());
        let help = "Reprojection RMSE of solved poses";
        registry.register_with_unit(
            "reprojection_error",
            help,
            Unit::Other("pixels".into()),
            metrics.reprojection.clone(),
        );
        registry.register(
            "batch_size",
            "Number of images processed together, counted for each image",
            metrics.batch_size.clone(),
        );
        registry.register("model_info", "Networks in use", metrics.models.clone());
        registry.register_collector(Box::new(QueueCollector { queue, memory }));
        metrics
    }

    /// From now on these networks are in use.
    pub(super) fn models(&self, library: &Library, provider: Provider) {
        self.models.clear();
        let shared =
            library.shared_detector().map(|model| ("detector".to_owned(), model.manifest.model_sha256.clone()));
        let own = library.own_detectors().into_iter().map(|(owner, sha256)| (format!("{owner}/detector"), sha256));
        for (model, sha256) in library.keypoint_nets().into_iter().chain(shared).chain(own) {
            let labels = ModelLabels { model, sha256, provider: provider.to_string() };
            self.models.get_or_create(&labels).set(1);
        }
    }

    pub(crate) fn request(&self, protocol: &'static str, route: &str, outcome: &'static str, duration: Duration) {
        let route = route.to_owned();
        self.requests.get_or_create(&RequestLabels { protocol, route: route.clone(), outcome }).inc();
        self.durations.get_or_create(&RouteLabels { protocol, route }).observe(duration.as_secs_f64());
    }

    pub(crate) fn answer(&self, answer: &Answer) {
        let timings = &answer.estimate.timings;
        for (stage, duration) in [
            ("queue", answer.queued),
            ("decode", answer.decode),
            ("detect", timings.detect),
            ("keypoints", timings.keypoints),
            ("pnp", timings.pnp),
        ] {
            self.stages.get_or_create(&StageLabels { stage }).observe(duration.as_secs_f64());
        }
        self.batch_size.observe(answer.batch_size as f64);
        for pose in &answer.estimate.poses {
            let labels = ObjectLabels { object: pose.object.clone(), status: pose.verdict.status.to_string() };
            self.objects.get_or_create(&labels).inc();
            if let Some(solved) = &pose.pose {
                self.reprojection.observe(solved.reprojection_rmse_px);
            }
        }
    }

    pub(crate) fn encode(&self) -> String {
        let mut buffer = String::new();
        // Writing to a string cannot fail.
        let _ = text::encode(&mut buffer, &self.registry);
        buffer
    }
}

/// Reads the queue's own counters when somebody asks.
#[derive(Debug)]
struct QueueCollector {
    queue: Queue,
    memory: Memory,
}

#[derive(Clone, Debug, EncodeLabelSet, Hash, PartialEq, Eq)]
struct ReasonLabels {
    reason: &'static str,
}

impl Collector for QueueCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> Result<(), std::fmt::Error> {
        let (stats, admission) = (self.queue.stats(), self.queue.admission());
        let mut counter = |name: &str, help: &str, value: u64| {
            let metric = ConstCounter::new(value);
            metric.encode(encoder.encode_descriptor(name, help, None, metric.metric_type())?)
        };
        let read = |value: &std::sync::atomic::AtomicU64| value.load(Ordering::Relaxed);
        counter("queue_enqueued", "Images admitted to the queue", read(&stats.admitted))?;
        counter("queue_refused", "Bodies and images rejected for lack of room or time", read(&stats.refused))?;
        counter("undecodable", "Images that could not be decoded", read(&stats.undecodable))?;
        counter("batches", "Groups of images that workers processed together", read(&stats.batches))?;
        counter("worker_restarts", "Worker restarts after a panic", read(&stats.worker_restarts))?;
        let help = "Times that a worker was taken out because its images took too long";
        counter("worker_timeouts", help, read(&stats.worker_timeouts))?;
        let dequeued = ConstCounter::new(0_u64);
        let help = "Images that left the queue";
        let mut family = encoder.encode_descriptor("queue_dequeued", help, None, dequeued.metric_type())?;
        for (reason, value) in [("worked", &stats.worked), ("expired", &stats.expired), ("cancelled", &stats.cancelled)]
        {
            ConstCounter::new(read(value)).encode(family.encode_family(&ReasonLabels { reason })?)?;
        }
        let mut gauge = |name: &str, help: &str, value: i64| {
            let metric = ConstGauge::new(value);
            metric.encode(encoder.encode_descriptor(name, help, None, metric.metric_type())?)
        };
        let signed = |value: usize| i64::try_from(value).unwrap_or(i64::MAX);
        let long = |value: u64| i64::try_from(value).unwrap_or(i64::MAX);
        gauge("inflight", "Images that are waiting or in progress", signed(admission.images()))?;
        gauge("body_bytes", "Size of all request bodies that the server holds", signed(admission.bytes()))?;
        gauge("ready_workers", "Workers that can take a batch", signed(stats.ready_workers.load(Ordering::Relaxed)))?;
        gauge("resident_memory_bytes", "Resident memory of the process", long(resident_bytes()))?;
        gauge("memory_bound_bytes", "Upper bound of resident memory", long(self.memory.bound().total_bytes()))
    }
}
