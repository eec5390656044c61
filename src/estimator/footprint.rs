//! What a worker takes at most beside its networks, so that a server can state a bound.

use super::detect::MAX_DETECTIONS;
use super::keypoints::MAX_BATCH;
use super::pipeline::Estimator;
use crate::model::{KeypointManifest, Library, Looking};
use crate::vision::MAX_CANVAS_BYTES;

/// Bytes of an RGB pixel, and of its three floats.
const RGB: u64 = 3;
const RGB_FLOATS: u64 = 12;

impl Estimator {
    /// Bytes that one worker holds at most while it answers a batch of so many images: the crops of all their boxes, the
    /// input of a network, and the canvas that a crop is cut from.
    #[must_use]
    pub fn working_bytes(library: &Library, max_batch: usize) -> u64 {
        let of_object = |manifest: &KeypointManifest| {
            let area = u64::from(manifest.input.size).pow(2);
            // Those of the first look are there beside those of the next.
            let crops_of_box = 1 + manifest.crop_ensemble.len() as u64;
            let boxes = (max_batch * MAX_DETECTIONS) as u64;
            area * (boxes * crops_of_box * RGB + MAX_BATCH as u64 * (RGB + RGB_FLOATS))
        };
        let objects = library.known().map(|object| of_object(&object.manifest)).max().unwrap_or(0);
        let letterbox = |looking: &Looking| {
            let input = &looking.model.manifest.input;
            u64::from(input.width) * u64::from(input.height) * (RGB + RGB_FLOATS)
        };
        let detectors = library.detectors.iter().map(letterbox).max().unwrap_or(0);
        objects.max(detectors) + MAX_CANVAS_BYTES
    }
}
