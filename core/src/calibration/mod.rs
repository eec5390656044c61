//! The offset between an object's virtual keypoints and the frame its user cares about (paper, section 3.4).
//!
//! The keypoints' frame was drawn at random before training, so a pose solved from them says nothing of the object's
//! frame until the constant `object_from_keypoints` is measured on a reference image with a known pose.

mod average;
mod clicks;
mod offset;

pub use average::{AverageError, Averaged, Consensus, Mode, ReferenceResidual, average};
pub use clicks::{Click, ClickError, ClickResidual, ClickedPair, ClickedReference, FrameClicks, reference_from_clicks};
pub use offset::Offset;
