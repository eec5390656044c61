//! HTTP and gRPC in front of the estimator's queue. Both are thin: translate, call, translate back.

mod cameras;
mod failure;
mod grpc;
mod http;
mod run;

pub use cameras::{CameraError, Cameras};
pub use run::{Config, ServeError, run};

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::estimator::Queue;

/// What every handler needs.
#[derive(Clone)]
struct App {
    queue: Queue,
    cameras: Arc<Cameras>,
    max_body_bytes: usize,
    /// False from the moment a shutdown is asked for.
    ready: Arc<AtomicBool>,
}
