//! `GET /v1/status`.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use utoipa::ToSchema;

use super::report::ModelsReport;
use crate::model::Provider;
use crate::server::service::{Latency, Limits, StatusSnapshot};

/// The current state of the server.
#[derive(Serialize, ToSchema)]
pub(crate) struct StatusReport {
    /// Whether the server accepts requests.
    ready: bool,
    /// Reason why the server is not ready.
    #[serde(skip_serializing_if = "Option::is_none")]
    trouble: Option<&'static str>,
    queue: QueueReport,
    workers: WorkersReport,
    last_minute: LastMinuteReport,
    models: ModelsReport,
    memory: MemoryInUse,
}

#[derive(Serialize, ToSchema)]
struct QueueReport {
    /// Images that are waiting or in progress.
    images: usize,
    max_images: usize,
    /// Size of all request bodies that the server holds.
    body_bytes: usize,
    max_body_bytes: usize,
}

#[derive(Serialize, ToSchema)]
struct WorkersReport {
    /// Workers that are ready to process images.
    ready: usize,
    /// Number of worker restarts since the start of the server. Each follows a fault.
    restarts: u64,
}

/// Requests for poses in the last minute, over HTTP and gRPC.
#[derive(Serialize, ToSchema)]
struct LastMinuteReport {
    /// Number of requests by outcome: `ok`, an error code, `cancelled` (the caller left) or `replaced` (by a newer frame).
    #[schema(value_type = BTreeMap<String, usize>)]
    outcomes: BTreeMap<&'static str, usize>,
    /// Successful requests per second.
    requests_per_second: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    latency_ms: Option<LatencyReport>,
}

/// Latency quantiles of the successful requests.
#[derive(Serialize, ToSchema)]
struct LatencyReport {
    p50: f64,
    p90: f64,
    p99: f64,
}

#[derive(Serialize, ToSchema)]
struct MemoryInUse {
    resident_bytes: u64,
    /// Upper bound of `resident_bytes`. `GET /v1/limits` has its parts.
    bound_bytes: u64,
}

impl StatusReport {
    pub(crate) fn new(now: StatusSnapshot, limits: &Limits, provider: Provider) -> Self {
        Self {
            ready: now.trouble.is_none(),
            trouble: now.trouble,
            queue: QueueReport {
                images: now.images,
                max_images: limits.queue,
                body_bytes: now.body_bytes,
                max_body_bytes: limits.queue_bytes,
            },
            workers: WorkersReport { ready: now.ready_workers, restarts: now.worker_restarts },
            last_minute: LastMinuteReport {
                outcomes: now.last_minute.outcomes,
                requests_per_second: round(now.last_minute.rate),
                latency_ms: now.last_minute.latency.map(Into::into),
            },
            models: ModelsReport::new(Some(&*now.library), provider),
            memory: MemoryInUse { resident_bytes: now.resident_bytes, bound_bytes: now.bound_bytes },
        }
    }
}

impl From<Latency> for LatencyReport {
    fn from(Latency { p50, p90, p99 }: Latency) -> Self {
        let [p50, p90, p99] = [p50, p90, p99].map(|time: Duration| round(time.as_secs_f64() * 1e3));
        Self { p50, p90, p99 }
    }
}

fn round(value: f64) -> f64 {
    (value * 1e2).round() / 1e2
}
