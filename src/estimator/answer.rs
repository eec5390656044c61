use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Matrix2, Vector2, Vector3};
use thiserror::Error;

use crate::model::{Catalogue, Evidence, RuntimeError};
use posed_core::geometry::{Camera, CameraError, Covariance6, Pose, rotated_covariance};
use posed_core::pnp::{PnpError, Status};
use posed_core::views::{Mode, Reading};

use super::hint::Hint;
use super::verdict::Verdict;
use crate::vision::{BoundingBox, ResampleError};

/// An image that cannot be estimated from.
#[derive(Clone, Debug, Error)]
pub enum EstimateError {
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error("{0}. If it is the full frame resized, set 'allow_resize'")]
    OtherSize(#[source] CameraError),
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    #[error(transparent)]
    Resample(#[from] ResampleError),
    #[error(transparent)]
    Abandoned(#[from] Abandoned),
    #[error(
        "field 'boxes[{place}].box_px' is {box_px:?}, of which the image ({width}x{height}) shows next to nothing; give x, y, \
         width, height in pixels of the posted image"
    )]
    BoxOutside { place: usize, box_px: [f64; 4], width: u32, height: u32 },
}

/// Nobody waits for the answer any more.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Abandoned {
    #[error("the time limit of the request expired; raise it, or send fewer requests at once")]
    Expired,
    #[error("the caller has disconnected")]
    Cancelled,
}

/// An image that an object's offset cannot be measured on.
#[derive(Clone, Debug, Error)]
pub enum MeasureError {
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    #[error(transparent)]
    Solve(#[from] PnpError),
    #[error("unknown object {0:?}")]
    UnknownObject(String),
    #[error("the detector does not find the object; set its box ('box_px'), or choose an image that shows it better")]
    NotSeen,
    #[error("no detector has the object among its labels; set its box ('box_px')")]
    NoLabel,
    #[error("field 'box_px' is {0:?}, which is outside the image; give x, y, width, height in pixels")]
    BoxOutside([f64; 4]),
    #[error("the detector finds the object more than once; set the box ('box_px') of the one whose pose is known")]
    SeveralSeen,
    #[error(
        "only {agreeing} of {keypoints} keypoints agree in this image; choose an image that shows the object larger and \
         unoccluded"
    )]
    FewInliers { agreeing: usize, keypoints: usize },
    #[error(
        "nothing can be measured in this image ({reasons}); choose a colour image that is as bright as those to come, with the \
         parameters of its camera"
    )]
    Unfit { reasons: String },
    #[error(
        "the pose in this image is doubtful ({reasons}); choose an image that shows the object larger and unoccluded"
    )]
    Doubtful { reasons: String },
}

/// What the caller wants of an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Names of objects; all calibrated ones where there is no list.
    pub objects: Option<Vec<String>>,
    /// At most so many of each object, the most trusted first.
    pub max_instances: Option<usize>,
    /// Poses with less [`ObjectPose::confidence`] are left out, 0..1.
    pub min_confidence: f64,
    /// Whether an image of another size than the camera's is its full frame, resized.
    pub allow_resize: bool,
    /// Where the objects are, as the caller knows: then no detector looks.
    pub boxes: Option<Vec<GivenBox>>,
}

/// A box that the caller has from a detector of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct GivenBox {
    pub object: String,
    /// Image pixels. What lies beyond the image is cut off.
    pub region: BoundingBox,
}

impl Selection {
    /// All calibrated objects.
    pub const ALL: Self =
        Self { objects: None, max_instances: None, min_confidence: 0.0, allow_resize: false, boxes: None };

    pub(super) fn wants(&self, object: &str) -> bool {
        self.objects.as_ref().is_none_or(|names| names.iter().any(|name| name == object))
    }
}

/// Where an object is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Place of the object in the library.
    pub object: usize,
    /// Box of the visible part, image pixels.
    pub bounding_box: BoundingBox,
    /// The detector's, 0..1; 1 for a box that the caller gave.
    pub score: f64,
    /// Place among the boxes that the caller gave; `None` where a detector saw it.
    pub given: Option<usize>,
}

/// What a keypoint net says, in image pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeypointPrediction {
    pub pixels: Vec<Vector2<f64>>,
    /// Calibrated 2x2 covariances, px².
    pub covariances: Vec<Matrix2<f64>>,
    /// Probability mass about each keypoint, 0..1.
    pub peaks: Vec<f64>,
    /// Where else the network sees them, if it says so.
    pub second: Option<SecondPeaks>,
    /// How little the crops look like those that the network learned from: about 1 for one of them.
    pub unfamiliarity: Option<f64>,
    /// How far the crops that it was averaged over differ.
    pub spread: Spread,
}

/// The second peaks of the keypoints' heatmaps: where an image leaves two answers open, they are the other one.
#[derive(Clone, Debug, PartialEq)]
pub struct SecondPeaks {
    pub pixels: Vec<Vector2<f64>>,
    /// Probability mass about each, of the mass about the first peak.
    pub weights: Vec<f64>,
}

/// How far the crops of one box agree. `None` where there was but one, or one look.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Root mean square distance of their keypoints from the mean, of the side of their place.
    pub apart: Option<f64>,
    /// Standard deviation of the logarithm of how far the keypoints are spread.
    pub scale: Option<f64>,
    /// Share of the crops that were left out, since they show the object in another way than most.
    pub left_out: f64,
    /// How far the keypoints lie from the place that the last look was cut for, of its side.
    pub moved: Option<f64>,
}

impl KeypointPrediction {
    /// Whether all of it are numbers that a pose may be solved from.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let pixels = self.pixels.iter().flatten().chain(self.covariances.iter().flatten());
        let second = self.second.iter().flat_map(|second| second.pixels.iter().flatten().chain(&second.weights));
        pixels.chain(&self.peaks).chain(second).chain(&self.unfamiliarity).all(|value| value.is_finite())
    }
}

/// One detected object with its pose.
#[derive(Clone, Debug)]
pub struct ObjectPose {
    pub object: String,
    pub verdict: Verdict,
    pub detection: Detection,
    /// The track that expected it there; its box is then the expected one, and its score that of its last detection. `None`
    /// where the detector found it.
    pub track: Option<u64>,
    /// `None` when no pose could be solved at all.
    pub pose: Option<SolvedPose>,
    /// The object's extent, metres: for pictures.
    pub diameter_m: f64,
}

impl ObjectPose {
    /// The probability that the pose is right, as far as the model states what its evidence is worth, 0..1; 0 where the pose
    /// is rejected. Of other models the weakest link, which is an order among answers, not a probability: the smallest of
    /// the detector's score, the share of keypoints that agree with the pose, and the pose's weight among its alternatives.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let trusted = self.pose.as_ref().filter(|_| self.verdict.status != Status::Rejected);
        trusted.map_or(0.0, |solved| {
            if let Some(probability) = solved.probability {
                return probability;
            }
            let agreeing = solved.inlier_count() as f64 / solved.keypoints.len().max(1) as f64;
            self.detection.score.min(agreeing).min(solved.weight)
        })
    }
}

/// A pose in the user's frame.
#[derive(Clone, Debug)]
pub struct SolvedPose {
    pub camera_from_object: Pose,
    /// The virtual keypoints as the network saw them. Of a symmetric object this may be another of its equal poses.
    pub camera_from_keypoints: Pose,
    pub covariance: Covariance6,
    /// The part of `covariance` that is this image's own, about the same axes. The rest is the offset's uncertainty: one error,
    /// the same in every image.
    pub image_covariance: Covariance6,
    pub reprojection_rmse_px: f64,
    pub keypoints: Vec<SolvedKeypoint>,
    /// How many of the keypoints lie beyond the domain of the lens model, and took no part.
    pub outside_lens: usize,
    /// Other poses with their posterior weights.
    pub alternatives: Vec<(Pose, f64)>,
    /// Posterior weight of this pose among the alternatives.
    pub weight: f64,
    /// What the image says by itself, for fusing it with others.
    pub observed: Observed,
    /// What the reference multiplies the virtual keypoints' coordinates by.
    pub keypoints_scale: f64,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// That it is right: that its ADD(-S) is below a tenth of the diameter, 0..1. `None` where the model states no
    /// probability.
    pub probability: Option<f64>,
    /// Corners of the box that the virtual keypoints span, in the camera's frame, metres; bit k of the index is axis k.
    pub box_in_camera: [Vector3<f64>; 8],
}

impl SolvedPose {
    /// Number of keypoints that the pose rests on.
    #[must_use]
    pub fn inlier_count(&self) -> usize {
        self.keypoints.iter().filter(|keypoint| keypoint.inlier).count()
    }

    /// The pose and its covariance in another frame, given the camera's pose there.
    #[must_use]
    pub fn in_frame(&self, frame_from_camera: &Pose) -> (Pose, Covariance6) {
        let covariance = rotated_covariance(frame_from_camera.rotation(), &self.covariance);
        (*frame_from_camera * self.camera_from_object, covariance)
    }

    /// As [`SolvedPose::in_frame`], with [`SolvedPose::image_covariance`]: for comparing the poses of several images.
    #[must_use]
    pub fn of_image_in_frame(&self, frame_from_camera: &Pose) -> (Pose, Covariance6) {
        let covariance = rotated_covariance(frame_from_camera.rotation(), &self.image_covariance);
        (*frame_from_camera * self.camera_from_object, covariance)
    }
}

/// What one image says of an object, in frame `keypoints` and without the offset's uncertainty, which all images share.
#[derive(Clone, Debug, Default)]
pub struct Observed {
    /// Where the network sees the virtual keypoints, image pixels: of each answer that it leaves open.
    pub readings: Vec<Reading>,
    /// The poses `camera_from_keypoints` that explain it, best first.
    pub modes: Vec<Mode>,
}

/// One keypoint of a solved pose.
#[derive(Clone, Copy, Debug)]
pub struct SolvedKeypoint {
    /// Where the network sees it, image pixels.
    pub pixel: Vector2<f64>,
    /// Probability mass about it, 0..1.
    pub peak: f64,
    /// Distance from the pose's projection, pixels. `None` beyond the domain of the lens model.
    pub residual_px: Option<f64>,
    pub inlier: bool,
}

/// Time spent in each stage. Images that were worked on together share the time of the keypoint nets.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    pub detect: Duration,
    pub keypoints: Duration,
    pub pnp: Duration,
}

/// The answer to one image.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub width: u32,
    pub height: u32,
    pub poses: Vec<ObjectPose>,
    /// The camera of this image: scaled, where the image is the camera's image resized.
    pub camera: Camera,
    /// The size that the camera was calibrated for, where it was scaled.
    pub camera_scaled_from: Option<(u32, u32)>,
    /// Whether objects may be missing, since there were as many detections as a limit allows: [`MAX_DETECTIONS`], or one of
    /// the detector itself.
    ///
    /// [`MAX_DETECTIONS`]: super::MAX_DETECTIONS
    pub truncated: bool,
    /// Why there is no pose of what was asked for by name, or of anything.
    pub hints: Vec<Hint>,
    pub timings: Timings,
    /// What it was made with.
    pub catalogue: Arc<Catalogue>,
}

/// Frames of the caller that the camera's pose is known in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CallerFrames {
    pub world_from_camera: Option<Pose>,
    pub base_from_camera: Option<Pose>,
}
