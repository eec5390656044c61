//! Why an answer has no pose of something.

use std::sync::Arc;

use super::answer::{ObjectPose, Selection};
use super::hint::Hint;
use crate::model::{Catalogue, Library};

/// What became of an image.
pub(super) struct Outcome<'a> {
    pub selection: &'a Selection,
    pub catalogue: &'a Catalogue,
    /// Whether detectors looked at it, or the caller gave boxes.
    pub looked: bool,
    /// Objects that were seen where another one was seen more clearly.
    pub covered: &'a [usize],
    /// The object of each pose, before poses were left out.
    pub found: &'a [usize],
    /// What is left of them.
    pub poses: &'a [ObjectPose],
}

impl Outcome<'_> {
    /// One for each object that was asked for by name and has no pose; at least one for an answer without poses.
    pub(super) fn hints(&self) -> Vec<Hint> {
        let Selection { objects, boxes, .. } = self.selection;
        let library = &self.catalogue.library;
        let of_boxes = boxes.iter().flatten().map(|given| given.object.as_str());
        let mut asked: Vec<&str> = objects.iter().flatten().map(String::as_str).chain(of_boxes).collect();
        let by_name = !asked.is_empty();
        if !by_name {
            // A list without boxes says itself that nothing is there.
            if !self.poses.is_empty() || boxes.is_some() {
                return Vec::new();
            }
            asked = library.known().map(|object| object.manifest.name.as_str()).collect();
        }
        let mut hints: Vec<Hint> = Vec::new();
        for (index, name) in asked.iter().enumerate() {
            let is_first = !asked[..index].contains(name);
            if is_first && !self.poses.iter().any(|pose| pose.object == *name) {
                hints.extend(self.reason(name, by_name).filter(|hint| !hints.contains(hint)));
            }
        }
        if !by_name && self.found.is_empty() {
            if library.detectors.is_empty() {
                hints.push(Hint::NoDetector);
            } else if self.looked {
                hints.push(Hint::NothingSeen { threshold: only_threshold(library) });
            }
        }
        hints
    }

    /// Why there is no pose of an object. Of those that nobody named, nothing is said that holds for all.
    fn reason(&self, name: &str, by_name: bool) -> Option<Hint> {
        let Catalogue { library, references } = self.catalogue;
        let object = name.to_owned();
        let Some(place) = library.place_of(name) else { return Some(Hint::Gone { object }) };
        if references.get(name).is_none() {
            return Some(Hint::NotCalibrated { problem: references.problem(name), object });
        }
        let poses = self.found.iter().filter(|found| **found == place).count();
        if poses > 0 {
            return Some(Hint::BelowConfidence { object, poses, min_confidence: self.selection.min_confidence });
        }
        let Some(detector) = library.detector_of(place) else { return Some(Hint::NoLabel { object }) };
        if !self.looked {
            return Some(Hint::NotLooked);
        }
        if self.covered.contains(&place) {
            return Some(Hint::Covered { object });
        }
        by_name.then(|| Hint::Unseen { object, threshold: detector.manifest.score_threshold })
    }
}

/// The threshold that all detectors have, if it is one.
fn only_threshold(library: &Arc<Library>) -> Option<f64> {
    let mut thresholds = library.detectors.iter().map(|looking| looking.model.manifest.score_threshold);
    let first = thresholds.next()?;
    thresholds.all(|other| other.total_cmp(&first).is_eq()).then_some(first)
}
