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
    pub max_side_px: u32,
    pub max_pixels: u64,
    pub max_batch_images: usize,
    pub max_views: usize,
    /// Images in work or waiting.
    pub queue: usize,
    pub queue_bytes: usize,
    pub pixel_bytes: usize,
    pub timeout: Duration,
    pub max_timeout: Duration,
    /// A client that sends nothing of its body for so long is cut off.
    pub body_timeout: Duration,
    pub exif_orientation: OrientationPolicy,
    /// Whether references may be replaced.
    pub recalibration: bool,
}

/// The bound of memory that is in force. Clones are one.
#[derive(Clone, Debug)]
pub(crate) struct Memory(Arc<RwLock<MemoryBound>>);

/// What the process takes at most, whatever its clients do: what it takes once it is warm, and all that they can add.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MemoryBound {
    /// Resident once the workers were warmed up.
    pub warm_bytes: u64,
    /// Bodies: twice `queue_bytes`.
    pub bodies_bytes: u64,
    /// Decoded images, and decoding: `pixel_bytes`.
    pub pixels_bytes: u64,
    /// Crops in the workers' hands.
    pub workers_bytes: u64,
    /// Buffers of connections: `max_connections`.
    pub connections_bytes: u64,
}

impl MemoryBound {
    pub(crate) fn total_bytes(&self) -> u64 {
        self.warm_bytes
            + self.bodies_bytes
            + self.pixels_bytes
            + self.workers_bytes
            + self.connections_bytes
    }
}

/// Forms and chunked bodies are copied once while they are taken apart.
const BODY_COPIES: u64 = 2;

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
            max_side_px: config.max_side_px,
            max_pixels: config.max_pixels,
            max_batch_images: config.max_batch_images,
            max_views: config.max_views,
            queue: config.queue,
            queue_bytes: config.queue_bytes,
            pixel_bytes: config.pixel_bytes,
            timeout: Duration::from_millis(config.timeout_ms),
            max_timeout: Duration::from_millis(config.max_timeout_ms),
            body_timeout: Duration::from_millis(config.body_timeout_ms),
            exif_orientation: config.exif_orientation,
            recalibration: config.recalibration,
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
        })))
    }

    pub(crate) fn bound(&self) -> MemoryBound {
        *self.0.read().unwrap_or_else(PoisonError::into_inner)
    }
}
