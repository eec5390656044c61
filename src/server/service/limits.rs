//! What requests are held to, and the memory that follows from it.

use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use super::memory::resident_bytes;
use crate::server::settings::Config;
use crate::vision::OrientationPolicy;

/// The JSON of one request: cameras and poses, not images.
pub(crate) const MAX_JSON_BYTES: usize = 256 * 1024;

/// What all connections of the front ends may take beside the bodies that are admitted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Connections {
    pub bytes: u64,
}

/// The limits that requests are held to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub max_body_bytes: usize,
    /// Of an object that is added.
    pub max_bundle_bytes: usize,
    pub max_side_px: u32,
    pub max_pixels: u64,
    pub max_batch_images: usize,
    /// Images that a worker works on together.
    pub max_batch: usize,
    pub max_views: usize,
    /// Images in work or waiting.
    pub queue: usize,
    pub queue_bytes: usize,
    pub pixel_bytes: usize,
    pub timeout: Duration,
    pub max_timeout: Duration,
    /// A change of objects that takes longer is given up.
    pub change_timeout: Duration,
    /// A client that sends nothing of its body for so long is cut off.
    pub body_timeout: Duration,
    pub exif_orientation: OrientationPolicy,
    /// Whether references may be replaced.
    pub recalibration: bool,
    /// Whether objects may be added and removed.
    pub object_changes: bool,
}

/// The bound of memory that is in force. Clones are one.
#[derive(Clone, Debug)]
pub(crate) struct Memory(Arc<RwLock<MemoryBound>>);

/// What the process takes at most, whatever its clients do: what it takes once it is warm, and all that they can add.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MemoryBound {
    /// Resident once the workers were warmed up, or after the last change of objects.
    pub warm_bytes: u64,
    /// Bodies: twice `queue_bytes`.
    pub bodies_bytes: u64,
    /// Decoded images, and decoding: `pixel_bytes`.
    pub pixels_bytes: u64,
    /// Crops in the workers' hands.
    pub workers_bytes: u64,
    /// Buffers of connections: `max_connections`.
    pub connections_bytes: u64,
    /// An object that is being added, where that is allowed: its files and its networks, several times `max_bundle_bytes`.
    pub object_changes_bytes: u64,
}

impl MemoryBound {
    pub(crate) fn total_bytes(&self) -> u64 {
        self.warm_bytes
            + self.bodies_bytes
            + self.pixels_bytes
            + self.workers_bytes
            + self.connections_bytes
            + self.object_changes_bytes
    }
}

/// Forms and chunked bodies are copied once while they are taken apart.
const BODY_COPIES: u64 = 2;

/// An object that is added: its files as they are kept, and a network that is compared with where it was trained.
const OBJECT_COPIES: usize = 3;
/// Its networks in each worker: as a message, and as the runtime keeps them.
const NETWORK_COPIES: usize = 2;

/// Images of batches leave this share of the queue to images that come alone.
const SINGLE_SHARE: usize = 4;

impl Limits {
    /// Places in the queue that images of batches may take.
    pub(super) fn batch_places(&self) -> usize {
        self.queue - self.queue / SINGLE_SHARE
    }

    pub(super) fn new(config: &Config) -> Self {
        Self {
            max_body_bytes: config.max_body_bytes,
            max_bundle_bytes: config.max_bundle_bytes,
            max_side_px: config.max_side_px,
            max_pixels: config.max_pixels,
            max_batch_images: config.max_batch_images,
            max_batch: config.max_batch,
            max_views: config.max_views,
            queue: config.queue,
            queue_bytes: config.queue_bytes,
            pixel_bytes: config.pixel_bytes,
            timeout: Duration::from_millis(config.timeout_ms),
            max_timeout: Duration::from_millis(config.max_timeout_ms),
            // Its bundle comes, and its networks run.
            change_timeout: Duration::from_millis(config.max_timeout_ms + config.worker_timeout_ms),
            body_timeout: Duration::from_millis(config.body_timeout_ms),
            exif_orientation: config.exif_orientation,
            recalibration: config.recalibration,
            object_changes: config.object_changes,
        }
    }
}

impl Memory {
    /// To be asked once the workers are warm.
    pub(super) fn new(config: &Config, workers_bytes: u64, connections: Connections) -> Self {
        Self(Arc::new(RwLock::new(MemoryBound {
            warm_bytes: resident_bytes(),
            bodies_bytes: BODY_COPIES * config.queue_bytes as u64,
            pixels_bytes: config.pixel_bytes as u64,
            workers_bytes,
            connections_bytes: connections.bytes,
            object_changes_bytes: if config.object_changes {
                ((OBJECT_COPIES + NETWORK_COPIES * config.workers()) * config.max_bundle_bytes) as u64
            } else {
                0
            },
        })))
    }

    /// Objects have changed: what is resident now is what it takes. It never falls, since part of that is of requests.
    pub(super) fn settle(&self, workers_bytes: u64) {
        let mut bound = self.0.write().unwrap_or_else(PoisonError::into_inner);
        bound.warm_bytes = bound.warm_bytes.max(resident_bytes());
        bound.workers_bytes = workers_bytes;
    }

    pub(crate) fn bound(&self) -> MemoryBound {
        *self.0.read().unwrap_or_else(PoisonError::into_inner)
    }
}
