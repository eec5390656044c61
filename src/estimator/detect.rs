//! A detector on one image: boxes in image pixels.

use std::time::{Duration, Instant};

use fast_image_resize::Resizer;
use image::RgbImage;
use nalgebra::Vector2;

use super::answer::{Detection, EstimateError};
use super::feed;
use super::rows::{Candidate, candidates};
use crate::model::{Looking, Network, Placement};
use crate::vision::{BoundingBox, Fit, Letterbox, Resampled, letterbox};

/// More objects than this that are asked for in one image are dropped, weakest first, and the answer says so.
pub const MAX_DETECTIONS: usize = 32;
/// Boxes of different classes with a larger intersection over union are one object.
const SAME_PLACE_OVERLAP: f64 = 0.7;
/// Of more boxes than this above the threshold the weakest are dropped; suppression takes quadratic time.
const MAX_CANDIDATES: usize = 1024;

/// Which detections are asked for.
pub(super) struct Wanted {
    /// For each place of the library.
    pub objects: Vec<bool>,
    pub least_score: f64,
}

impl Wanted {
    pub(super) fn object(&self, place: usize) -> bool {
        self.objects.get(place).is_some_and(|wanted| *wanted)
    }
}

/// What is seen of what is asked for.
#[derive(Default)]
pub(super) struct Seen {
    /// The strongest first.
    pub detections: Vec<Detection>,
    /// Whether there may be more, beyond a limit.
    pub truncated: bool,
    /// Objects that were seen where another one was seen more clearly.
    pub covered: Vec<usize>,
    pub elapsed: Duration,
}

/// A box of a class in the image's pixels.
struct InImage {
    class: usize,
    bounding_box: BoundingBox,
    score: f64,
}

/// Runs a detector on one image.
pub(super) fn detect(
    looking: &Looking,
    network: &mut dyn Network,
    resizer: &mut Resizer,
    image: &RgbImage,
    wanted: &Wanted,
) -> Result<Seen, EstimateError> {
    let start = Instant::now();
    let manifest = &looking.model.manifest;
    let place_of = |class: usize| looking.objects.get(class).copied().flatten().filter(|place| wanted.object(*place));
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
    let by_network = found.cut.iter().enumerate().any(|(class, cut)| *cut && place_of(class).is_some());
    let is_wanted = |class: usize, score: f64| place_of(class).filter(|_| score >= wanted.least_score);
    let by_candidates = beyond.iter().any(|candidate| is_wanted(candidate.class, candidate.score).is_some());
    let in_image = found.boxes.iter().filter_map(|candidate| in_image(candidate, &boxed, image));
    // Also by what is not asked for: an object is not taken for another because nobody asked for it.
    let (kept, covered) = suppress(in_image, manifest.iou_threshold);
    let detection = |found: InImage| {
        let InImage { class, bounding_box, score } = found;
        is_wanted(class, score).map(|object| Detection { object, bounding_box, score, given: None })
    };
    Ok(Seen {
        detections: kept.into_iter().filter_map(detection).collect(),
        truncated: by_network || by_candidates,
        covered: covered.into_iter().filter_map(|found| is_wanted(found.class, found.score)).collect(),
        elapsed: start.elapsed(),
    })
}

/// A box in the image's pixels; `None` where it is not in the image.
fn in_image(candidate: &Candidate, boxed: &Resampled, image: &RgbImage) -> Option<InImage> {
    let image_from_input = boxed.crop_from_image.inverse();
    let image_size = Vector2::new(f64::from(image.width()), f64::from(image.height()));
    let [x1, y1, x2, y2] = candidate.corners;
    // Edges to pixel centres and back: the affine maps centres.
    let edge = |x: f64, y: f64| image_from_input.apply(&Vector2::new(x - 0.5, y - 0.5)).add_scalar(0.5);
    let bounding_box = BoundingBox::within(&edge(x1, y1), &edge(x2, y2), &image_size)?;
    Some(InImage { class: candidate.class, bounding_box, score: candidate.score.min(1.0) })
}

/// Leaves out what overlaps a stronger detection: of the same class beyond the manifest's threshold, of another class only
/// where both claim one place. The second list has the latter.
fn suppress(strongest_first: impl Iterator<Item = InImage>, iou_threshold: f64) -> (Vec<InImage>, Vec<InImage>) {
    let (mut kept, mut covered): (Vec<InImage>, Vec<InImage>) = (Vec::new(), Vec::new());
    for found in strongest_first {
        let takes = |k: &&InImage| {
            let limit = if k.class == found.class { iou_threshold } else { SAME_PLACE_OVERLAP };
            k.bounding_box.overlap(&found.bounding_box) > limit
        };
        match kept.iter().find(takes).map(|k| k.class == found.class) {
            None => kept.push(found),
            Some(true) => {}
            Some(false) => covered.push(found),
        }
    }
    (kept, covered)
}
