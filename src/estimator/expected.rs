//! Objects that are looked for where earlier images say that they are.

use nalgebra::Vector2;

use super::answer::Detection;
use super::keypoints::closer;
use crate::model::KeypointManifest;
use crate::vision::{BoundingBox, Square, box_corners};
use posed_core::geometry::{Camera, Pose};

/// What is known of an image before it is seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Guide {
    pub expected: Vec<Expected>,
    /// Whether the detector looks as well, for what nobody expects.
    pub detect: bool,
    /// Of the library that the places of expected objects are of: with another one, the detector looks at the whole image.
    pub generation: u64,
}

/// An object, and where it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Its number in the stream: the answer repeats it.
    pub track: u64,
    /// Index in the library.
    pub object: usize,
    pub camera_from_keypoints: Pose,
    /// What the coordinates of the keypoints are multiplied by.
    pub keypoints_scale: f64,
    /// What the detector gave it, 0..1.
    pub score: f64,
}

/// Intersection over union from which on a detection is of an expected object.
const CONFIRMS: f64 = 0.4;
/// The detector looked and did not see it.
const UNSEEN: f64 = 0.5;
/// Share of an object's keypoints that must be in the image for a look at it.
const IN_IMAGE: f64 = 0.5;

/// Something to look at closely.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub detection: Detection,
    /// `None` where the detector found it.
    pub expected: Option<Place>,
}

/// Where an expected object is looked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub track: u64,
    pub square: Square,
}

impl Expected {
    /// `None` where it is not in the image.
    pub(super) fn found(&self, manifest: &KeypointManifest, camera: &Camera, size: (u32, u32)) -> Option<Found> {
        let size = Vector2::new(f64::from(size.0), f64::from(size.1));
        let keypoints = manifest.keypoints_scaled_by(self.keypoints_scale);
        let pixel = |point| camera.project(&self.camera_from_keypoints.transform(point)).ok();
        let pixels = keypoints.iter().map(pixel).collect::<Option<Vec<_>>>()?;
        let is_inside = |pixel: &&Vector2<f64>| pixel.min() >= 0.0 && (size - *pixel).min() > 0.0;
        if (pixels.iter().filter(is_inside).count() as f64) < IN_IMAGE * pixels.len() as f64 {
            return None;
        }
        let corners = box_corners(&keypoints);
        let corners = corners.iter().map(pixel).collect::<Option<Vec<_>>>()?;
        let bounding_box = visible_box(&corners, size)?;
        let square = match &manifest.second_look {
            Some(look) => closer(&pixels, &keypoints, look),
            None => Square::around(&bounding_box),
        };
        let detection = Detection { object: self.object, bounding_box, score: self.score, given: None };
        Some(Found { detection, expected: Some(Place { track: self.track, square }) })
    }
}

fn visible_box(pixels: &[Vector2<f64>], size: Vector2<f64>) -> Option<BoundingBox> {
    let first = pixels.iter().fold(size, |least, pixel| least.inf(pixel));
    let last = pixels.iter().fold(Vector2::zeros(), |most: Vector2<f64>, pixel| most.sup(pixel));
    BoundingBox::within(&first, &last, &size)
}

/// What to look at: what is expected, and the detections that it does not explain. `seen` is `None` where no detector looked.
/// Of each object, expectations with a lower score are given up.
pub(super) fn look_at(
    expected: Vec<Found>,
    seen: Option<Vec<Detection>>,
    least_score: impl Fn(usize) -> f64,
) -> Vec<Found> {
    let Some(mut seen) = seen else { return expected };
    let mut found = Vec::new();
    let mut explained = vec![false; seen.len()];
    for mut one in expected {
        let of_it = |other: &Detection| {
            other.object == one.detection.object && other.bounding_box.overlap(&one.detection.bounding_box) > CONFIRMS
        };
        let confirming = seen.iter().enumerate().filter(|(_, other)| of_it(other));
        let best = confirming.max_by(|(_, a), (_, b)| a.score.total_cmp(&b.score)).map(|(at, _)| at);
        if let Some(at) = best {
            explained[at] = true;
            one.detection = Detection { bounding_box: one.detection.bounding_box, ..seen[at] };
        } else {
            one.detection.score *= UNSEEN;
        }
        if one.detection.score >= least_score(one.detection.object) {
            found.push(one);
        }
    }
    let mut explained = explained.into_iter();
    seen.retain(|_| !explained.next().unwrap_or_default());
    found.extend(seen.into_iter().map(|detection| Found { detection, expected: None }));
    found
}
