use posed_core::geometry::{Covariance6, Pose};
use posed_core::pnp::Status;
use serde::Serialize;

use super::metrics::{Deviation, PoseNees, ScoredView};
use crate::model::Evidence;
use crate::vision::BoundingBox;

/// What an estimator said of one object in one image: posed itself, or any other whose results are in a file.
#[derive(Clone, Debug)]
pub struct Answer {
    /// `camera_from_object`; `None` where it saw the object and found no pose.
    pub pose: Option<Pose>,
    /// Other poses that explain the image about as well.
    pub alternatives: Vec<Pose>,
    /// Of [`Pose::perturbed`] in the camera's frame; `None` where the estimator states none.
    pub covariance: Option<Covariance6>,
    /// Larger is better: posed's lies in 0..1.
    pub confidence: f64,
    pub status: Status,
    /// Why it is not `ok`.
    pub reasons: Vec<String>,
    /// What posed rests its trust on; `None` of other estimators.
    pub evidence: Option<Evidence>,
    /// As `covariance`, without the uncertainty that all answers share: that of the object's offset.
    pub image_covariance: Option<Covariance6>,
    /// What its detector saw; `None` where it had none, or does not say.
    pub detection: Option<DetectedBox>,
}

/// A detector's box, image pixels, and its score, 0..1.
#[derive(Clone, Copy, Debug)]
pub struct DetectedBox {
    pub region: BoundingBox,
    pub score: f64,
}

/// Which object of which image.
#[derive(Clone, Debug, Serialize, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// The scene's folder.
    pub scene: String,
    pub image_id: u32,
    /// Place in the image's list of ground truth.
    pub instance: usize,
}

/// One object that is known to be in an image, and what was said of it.
#[derive(Clone, Debug)]
pub struct Record {
    pub place: Place,
    /// 0..1.
    pub visible_fraction: f64,
    pub camera_from_object: Pose,
    /// Box of the visible part, image pixels.
    pub region: BoundingBox,
    /// Of the image, pixels.
    pub image_width_px: u32,
    /// `None` where nothing was said: it counts as wrong.
    pub said: Option<Scored>,
}

/// An answer, and how far its pose is from the truth.
#[derive(Clone, Debug)]
pub struct Scored {
    pub answer: Answer,
    /// `None` where there is no pose.
    pub deviation: Option<Deviation>,
    /// Of the alternatives.
    pub of_alternatives: Vec<Deviation>,
    /// In units of its covariance; `None` where there is no usable one.
    pub nees: Option<PoseNees>,
    /// The same in units of the covariance that is the image's own.
    pub image_nees: Option<PoseNees>,
}

/// An answer that means none of the instances in its image.
#[derive(Clone, Debug)]
pub struct Unmatched {
    pub scene: String,
    pub image_id: u32,
    pub answer: Answer,
}

impl Record {
    /// As statistics take it.
    #[must_use]
    pub fn view(&self, diameter_m: f64) -> ScoredView {
        ScoredView { deviation: self.deviation(), diameter_m, image_width_px: self.image_width_px }
    }

    /// Whether there is an answer with status `ok`.
    #[must_use]
    pub fn is_ok(&self) -> bool {
        self.said.as_ref().is_some_and(|said| said.answer.status == Status::Ok)
    }

    #[must_use]
    pub fn deviation(&self) -> Option<Deviation> {
        self.said.as_ref().and_then(|said| said.deviation)
    }
}
