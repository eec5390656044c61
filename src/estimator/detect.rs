//! A detector on one image: boxes in image pixels.

use std::time::{Duration, Instant};

use fast_image_resize::Resizer;
use image::RgbImage;
use nalgebra::Vector2;

use super::answer::{Detection, EstimateError};
use super::feed;
use super::rows::{Candidate, candidates};
use crate::model::{DetectorManifest, Network, Placement};
use crate::vision::{BoundingBox, Fit, Letterbox, Resampled, letterbox};

/// More objects than this that are asked for in one image are dropped, weakest first, and the answer says so.
pub const MAX_DETECTIONS: usize = 32;
/// Boxes of different classes with a larger intersection over union are one object.
const SAME_PLACE_OVERLAP: f64 = 0.7;
/// Of more boxes than this above the threshold the weakest are dropped; suppression takes quadratic time.
const MAX_CANDIDATES: usize = 1024;

/// Which detections are asked for.
pub(super) struct Wanted {
    /// For each class.
    pub classes: Vec<bool>,
    pub least_score: f64,
}

impl Wanted {
    fn class(&self, class: usize) -> bool {
        self.classes.get(class).is_some_and(|wanted| *wanted)
    }

    fn wants(&self, class: usize, score: f64) -> bool {
        self.class(class) && score >= self.least_score
    }
}

/// What a detector sees of what is asked for.
pub(super) struct Seen {
    /// The strongest first.
    pub detections: Vec<Detection>,
    /// Whether there may be more, beyond a limit.
    pub truncated: bool,
    pub elapsed: Duration,
}

/// Runs the detector on one image.
pub(super) fn detect(
    manifest: &DetectorManifest,
    network: &mut dyn Network,
    resizer: &mut Resizer,
    image: &RgbImage,
    wanted: &Wanted,
) -> Result<Seen, EstimateError> {
    let start = Instant::now();
    let input = &manifest.input;
    let fit = match input.placement {
        Placement::TopLeft => Fit::TopLeft,
        Placement::Centre => Fit::Centre,
        Placement::Stretch => Fit::Stretch,
    };
    let to = Letterbox { width: input.width, height: input.height, fill: input.fill, fit };
    let boxed = letterbox(resizer, image, to)?;
    let outputs = feed::run(network, &input.pixels(), &boxed.rgb, [input.width as usize, input.height as usize])?;
    let mut found = candidates(manifest, &outputs, wanted.least_score)?;
    found.boxes.sort_by(|a, b| b.score.total_cmp(&a.score));
    let beyond = found.boxes.split_off(found.boxes.len().min(MAX_CANDIDATES));
    let by_network = found.cut.iter().enumerate().any(|(class, cut)| *cut && wanted.class(class));
    let by_candidates = beyond.iter().any(|candidate| wanted.wants(candidate.class, candidate.score));
    let detections = found.boxes.iter().filter_map(|candidate| in_image(candidate, &boxed, image));
    // Also by what is not asked for: an object is not taken for another because nobody asked for it.
    let mut detections = suppress(detections, manifest.iou_threshold);
    detections.retain(|detection| wanted.wants(detection.object, detection.score));
    let truncated = by_network || by_candidates || detections.len() > MAX_DETECTIONS;
    detections.truncate(MAX_DETECTIONS);
    Ok(Seen { detections, truncated, elapsed: start.elapsed() })
}

/// A box in the image's pixels; `None` where it is not in the image.
fn in_image(candidate: &Candidate, boxed: &Resampled, image: &RgbImage) -> Option<Detection> {
    let image_from_input = boxed.crop_from_image.inverse();
    let image_size = Vector2::new(f64::from(image.width()), f64::from(image.height()));
    let [x1, y1, x2, y2] = candidate.corners;
    // Edges to pixel centres and back: the affine maps centres.
    let edge = |x: f64, y: f64| image_from_input.apply(&Vector2::new(x - 0.5, y - 0.5)).add_scalar(0.5);
    let bounding_box = BoundingBox::within(&edge(x1, y1), &edge(x2, y2), &image_size)?;
    Some(Detection { object: candidate.class, bounding_box, score: candidate.score.min(1.0) })
}

/// Drops what overlaps a stronger detection: of the same class beyond the manifest's threshold, of another class only
/// where both claim one place.
fn suppress(strongest_first: impl Iterator<Item = Detection>, iou_threshold: f64) -> Vec<Detection> {
    let mut kept: Vec<Detection> = Vec::new();
    for detection in strongest_first {
        let taken = kept.iter().any(|k| {
            let limit = if k.object == detection.object { iou_threshold } else { SAME_PLACE_OVERLAP };
            k.bounding_box.overlap(&detection.bounding_box) > limit
        });
        if !taken {
            kept.push(detection);
        }
    }
    kept
}
