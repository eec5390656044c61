use super::seen::Seen;
use crate::evaluation::metrics::Matching;
use crate::evaluation::record::{Record, Unmatched};
use crate::evaluation::visibility::VisibleRange;

/// All that is known of one object in one split.
pub struct ObjectRecords {
    pub split: String,
    pub object: String,
    pub diameter_m: f64,
    pub records: Vec<Record>,
    /// Answers that mean none of the instances that are there.
    pub unmatched: Vec<Unmatched>,
    /// What the detector found in each image; empty without one.
    pub matchings: Vec<Matching>,
}

impl ObjectRecords {
    pub(super) fn seen(&self, range: &VisibleRange) -> impl Iterator<Item = Seen<'_>> {
        let inside = |record: &&Record| range.contains(record.visible_fraction);
        let seen = |record| Seen { record, view: Record::view(record, self.diameter_m) };
        self.records.iter().filter(inside).map(seen)
    }
}
