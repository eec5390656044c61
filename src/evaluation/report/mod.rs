//! From records to a report: what people, scripts and pages are told.

mod lines;
mod objects;
mod picks;
mod section;
mod seen;
mod verdicts;

use posed_core::pnp::Status;
use serde::Serialize;

use super::metrics::DetectionScore;
use super::visibility::VisibleRange;
pub use lines::{FalseLine, ViewLine};
pub use objects::ObjectRecords;
pub use picks::{Picks, picks};
pub use section::{Intervals, Section};
use seen::Seen;
pub use verdicts::{Counted, Verdicts};

/// What the views of all objects together are called.
const ALL: &str = "(all)";

/// Where the estimator looked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Boxes {
    /// In the true boxes.
    GroundTruth,
    /// Where its detector saw something.
    Detector,
    /// Poses come from a file; nobody knows.
    File,
}

/// Accuracy of objects on splits.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Of posed.
    pub version: &'static str,
    pub boxes: Boxes,
    /// For each split, range of visibility and object that has views; and for all objects of a split taken together.
    pub sections: Vec<Section>,
    /// For each split and object: where the detector looked.
    pub detection: Vec<Detections>,
    /// Every view that was scored.
    pub views: Vec<ViewLine>,
    /// Every answer where there is no such object.
    pub false_answers: Vec<FalseLine>,
}

/// What the detector found of one object, and what followed where there is none.
#[derive(Clone, Debug, Serialize)]
pub struct Detections {
    pub split: String,
    pub object: String,
    /// Of boxes at an intersection over union of 0.5; objects outside of the ranges of visibility count neither way.
    #[serde(flatten)]
    pub score: DetectionScore,
    /// Poses of false boxes that are `ok` nevertheless.
    pub false_ok: usize,
}

impl Report {
    #[must_use]
    pub fn new(boxes: Boxes, visible: &[VisibleRange], objects: &[ObjectRecords]) -> Self {
        let has_detector = boxes == Boxes::Detector;
        let section = |object: &str, of: &[ObjectRecords], range: &VisibleRange| {
            let seen: Vec<Seen<'_>> = of.iter().flat_map(|one| one.seen(range)).collect();
            Section::new(&of[0].split, object, *range, has_detector, &seen)
        };
        let of_split = |of: &[ObjectRecords], range: &VisibleRange| -> Vec<Section> {
            let each = of.chunks(1).filter_map(|one| section(&one[0].object, one, range));
            let all = if of.len() > 1 { section(ALL, of, range) } else { None };
            each.chain(all).collect()
        };
        let splits = || objects.chunk_by(|a, b| a.split == b.split);
        let sections = splits().flat_map(|of| visible.iter().flat_map(move |range| of_split(of, range)));
        let detections = |of: &ObjectRecords| Detections {
            split: of.split.clone(),
            object: of.object.clone(),
            score: of.matchings.iter().sum(),
            false_ok: of.unmatched.iter().filter(|one| one.answer.status == Status::Ok).count(),
        };
        Self {
            version: env!("CARGO_PKG_VERSION"),
            boxes,
            sections: sections.collect(),
            views: objects.iter().flat_map(|of| of.records.iter().map(|record| ViewLine::new(of, record))).collect(),
            false_answers: objects
                .iter()
                .flat_map(|of| of.unmatched.iter().map(|one| FalseLine::new(of, one)))
                .collect(),
            detection: objects.iter().filter(|_| has_detector).map(detections).collect(),
        }
    }
}
