use std::fs;
use std::path::Path;

use serde::Serialize;

use super::error::ResultsError;
use crate::vision::BoundingBox;

/// One detection, as the BOP toolkit's `eval_bop22_coco.py` reads it: a 2D box in the format of COCO.
#[derive(Clone, Debug, Serialize)]
pub struct BoxResult {
    pub scene_id: u32,
    pub image_id: u32,
    /// `obj_id` of the dataset.
    pub category_id: u32,
    /// x, y, width, height, pixels.
    pub bbox: [f64; 4],
    /// 0..1.
    pub score: f64,
    /// Of the whole image, seconds.
    pub time: f64,
}

impl BoxResult {
    #[must_use]
    pub fn new(scene_id: u32, image_id: u32, obj_id: u32, region: BoundingBox, score: f64, time_s: f64) -> Self {
        Self { scene_id, image_id, category_id: obj_id, bbox: region.into(), score, time: time_s }
    }
}

/// Writes detections as one JSON list.
///
/// # Errors
/// When the file cannot be written.
pub fn write_boxes(path: &Path, boxes: &[BoxResult]) -> Result<(), ResultsError> {
    let write = || fs::write(path, serde_json::to_vec(boxes).map_err(std::io::Error::from)?);
    write().map_err(|source| ResultsError::Write { path: path.into(), source })
}
