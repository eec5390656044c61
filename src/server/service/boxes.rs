//! Boxes that a request brings along, from a detector of the caller's own.

use super::failure::{Failure, FailureKind};
use crate::estimator::{GivenBox, MAX_DETECTIONS};
use crate::vision::BoundingBox;

/// A box as it came.
#[derive(Clone, Debug)]
pub(crate) struct RequestedBox {
    pub object: String,
    /// x, y, width, height in pixels of the posted image.
    pub box_px: [f64; 4],
}

/// Nothing can be seen in less.
const MIN_SIDE_PX: f64 = 2.0;
/// No image is larger; what is, is no pixels.
const MAX_PX: f64 = 65_536.0;

impl RequestedBox {
    /// How many a request may have.
    pub(crate) fn check_count(boxes: Option<&[Self]>) -> Result<(), Failure> {
        match boxes {
            Some([]) => {
                let message = "field 'boxes' is empty; give at least one box, or omit it to let the detector look";
                Err(Failure::invalid(message))
            }
            Some(boxes) if boxes.len() > MAX_DETECTIONS => {
                let count = boxes.len();
                let message =
                    format!("field 'boxes' has {count} boxes, but the limit is {MAX_DETECTIONS} ('max_detections')");
                Err(Failure::new(FailureKind::TooLarge, message))
            }
            Some(_) | None => Ok(()),
        }
    }

    /// The box at this place in the request, where something can be seen in it. Whether it is in the image is known later.
    pub(super) fn checked(self, place: usize) -> Result<GivenBox, Failure> {
        let Self { object, box_px } = self;
        let [x, y, width, height] = box_px;
        let usable = [x, y].iter().all(|at| at.abs() <= MAX_PX)
            && [width, height].iter().all(|side| (MIN_SIDE_PX..=MAX_PX).contains(side));
        if !usable {
            return Err(Failure::invalid(format!(
                "field 'boxes[{place}].box_px' is {box_px:?}; give x, y, width, height in pixels, sides from {MIN_SIDE_PX} to \
                 {MAX_PX}"
            )));
        }
        Ok(GivenBox { object, region: BoundingBox::from(box_px) })
    }
}
