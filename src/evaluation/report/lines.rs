use posed_core::pnp::Status;
use serde::Serialize;

use super::objects::ObjectRecords;
use crate::evaluation::metrics::{Deviation, PoseNees};
use crate::evaluation::record::{Place, Record, Unmatched};
use crate::model::Evidence;

/// One view, for scripts that ask what the tables do not.
#[derive(Clone, Debug, Serialize)]
pub struct ViewLine {
    pub split: String,
    pub object: String,
    #[serde(flatten)]
    pub place: Place,
    pub visible_fraction: f64,
    /// ADD(-S) below a tenth of the diameter.
    pub right: bool,
    /// The same of one of the answer's alternatives.
    pub right_alternative: bool,
    /// `None`, as the rest, where there is no answer.
    pub status: Option<Status>,
    pub reasons: Vec<String>,
    pub confidence: Option<f64>,
    pub deviation: Option<Deviation>,
    pub nees: Option<PoseNees>,
    /// In units of the covariance that is the image's own, without the offset's.
    pub image_nees: Option<PoseNees>,
    /// What posed's trust in the pose rests on.
    pub evidence: Option<Evidence>,
}

/// An answer where there is no such object.
#[derive(Clone, Debug, Serialize)]
pub struct FalseLine {
    pub split: String,
    pub object: String,
    pub scene: String,
    pub image_id: u32,
    pub status: Status,
    pub confidence: f64,
    /// x, y, width, height, pixels.
    pub box_px: Option<[f64; 4]>,
}

impl ViewLine {
    pub(super) fn new(of: &ObjectRecords, record: &Record) -> Self {
        let said = record.said.as_ref();
        Self {
            split: of.split.clone(),
            object: of.object.clone(),
            place: record.place.clone(),
            visible_fraction: record.visible_fraction,
            right: record.view(of.diameter_m).is_right(),
            right_alternative: said
                .is_some_and(|said| said.of_alternatives.iter().any(|one| one.is_right(of.diameter_m))),
            status: said.map(|said| said.answer.status),
            reasons: said.map_or_else(Vec::new, |said| said.answer.reasons.clone()),
            confidence: said.map(|said| said.answer.confidence),
            deviation: record.deviation(),
            nees: said.and_then(|said| said.nees),
            image_nees: said.and_then(|said| said.image_nees),
            evidence: said.and_then(|said| said.answer.evidence),
        }
    }
}

impl FalseLine {
    pub(super) fn new(of: &ObjectRecords, one: &Unmatched) -> Self {
        Self {
            split: of.split.clone(),
            object: of.object.clone(),
            scene: one.scene.clone(),
            image_id: one.image_id,
            status: one.answer.status,
            confidence: one.answer.confidence,
            box_px: one.answer.detection.map(|seen| seen.region.into()),
        }
    }
}
