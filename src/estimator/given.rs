//! Boxes that the caller gave: in place of what detectors see.

use nalgebra::Vector2;

use super::answer::{Detection, EstimateError, GivenBox};
use super::detect::Wanted;
use crate::model::Library;
use crate::vision::BoundingBox;

/// The boxes as detections: what the image shows of each. Those of objects that are gone meanwhile are left out.
pub(super) fn detections(
    boxes: &[GivenBox],
    library: &Library,
    wanted: &Wanted,
    (width, height): (u32, u32),
) -> Result<Vec<Detection>, EstimateError> {
    let image_size = Vector2::new(f64::from(width), f64::from(height));
    let mut detections = Vec::with_capacity(boxes.len());
    for (place, GivenBox { object, region }) in boxes.iter().enumerate() {
        let first = Vector2::new(region.x, region.y);
        let last = first + Vector2::new(region.width, region.height);
        let bounding_box = BoundingBox::within(&first, &last, &image_size);
        let outside = || EstimateError::BoxOutside { place, box_px: (*region).into(), width, height };
        let bounding_box = bounding_box.ok_or_else(outside)?;
        if let Some(object) = library.place_of(object).filter(|object| wanted.object(*object)) {
            detections.push(Detection { object, bounding_box, score: 1.0, given: Some(place) });
        }
    }
    Ok(detections)
}
