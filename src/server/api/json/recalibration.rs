//! The part `request` of a recalibration.

use std::fmt;

use nalgebra::Vector2;
use posed_core::calibration::{Click, FrameClicks, Mode};
use serde::Deserialize;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use utoipa::ToSchema;

use super::forms::{CameraChoiceForm, PoseForm, PoseSchema};
use crate::server::service::{CameraChoice, ClickedPose, Failure, KnownPose, KnownView};
use crate::vision::BoundingBox;

/// The part `request` of a recalibration: `references` or `clicks`. Unknown fields are an error.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReferenceRequest {
    /// One entry for each part `image`, in the same order.
    references: Option<Vec<ReferenceImage>>,
    /// Points clicked in two images with a known relative pose, as in the file of `posed calibrate --clicks`: one pair, or
    /// a list of pairs, one entry for each part `image`, in the same order.
    #[schema(value_type = Option<PairsSchema>)]
    clicks: Option<Pairs>,
    /// How several images are averaged: `weighted` (default) weights each image by its information, `paper` does not.
    #[serde(default)]
    #[schema(value_type = String, example = "weighted")]
    pub mode: Mode,
    /// Whether the origin of the object's frame may lie farther from the object than the object is large.
    #[serde(default)]
    pub far_origin: bool,
    /// Whether `keypoints_scale` follows from these references: for a network that sees its object a percent too large or too
    /// small. Needs at least three references from different sides. Without it the scale in force stays.
    #[serde(default)]
    pub fit_scale: bool,
}

/// The known facts about one reference image.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct ReferenceImage {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoiceForm)]
    camera: CameraChoice,
    /// Pose of the object in this image.
    #[schema(value_type = PoseSchema)]
    camera_from_object: PoseForm,
    /// Box of the object: x, y, width, height in pixels. Omit this if the detector finds the object exactly once.
    box_px: Option<[f64; 4]>,
}

/// One pair of images, or several.
#[derive(ToSchema)]
#[schema(as = ClickedPairs)]
#[serde(untagged)]
#[expect(dead_code, clippy::large_enum_variant, reason = "describes JSON")]
enum PairsSchema {
    #[schema(title = "pair")]
    One(ClicksForm),
    #[schema(title = "pairs")]
    Several(Vec<ClicksForm>),
}

struct Pairs(Vec<ClicksForm>);

impl<'de> Deserialize<'de> for Pairs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PairsVisitor)
    }
}

/// Distinguishes a pair from a list by the JSON type, so that errors inside a pair are reported as such.
struct PairsVisitor;

impl<'de> Visitor<'de> for PairsVisitor {
    type Value = Pairs;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a pair of images with clicks, or a list of pairs")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Pairs, A::Error> {
        Ok(Pairs(vec![ClicksForm::deserialize(MapAccessDeserializer::new(map))?]))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Pairs, A::Error> {
        Vec::deserialize(SeqAccessDeserializer::new(list)).map(Pairs)
    }
}

/// Two images with a known relative pose, and points of the object clicked in both. The first image is the reference image.
#[derive(Deserialize, ToSchema)]
#[schema(as = ClickedPair)]
#[serde(deny_unknown_fields)]
struct ClicksForm {
    /// Id of a registered camera, or a camera: that of the first image.
    #[schema(value_type = CameraChoiceForm)]
    first_camera: CameraChoice,
    /// The same for the second image.
    #[schema(value_type = CameraChoiceForm)]
    second_camera: CameraChoice,
    /// Pose of the first camera in the frame of the second one.
    #[schema(value_type = PoseSchema)]
    second_from_first: PoseForm,
    /// 4 to 16 points.
    clicks: Vec<ClickForm>,
    frame: FrameForm,
    /// Standard deviation of a click, pixels.
    #[serde(default = "usual_click_error")]
    #[schema(default = 1.0)]
    sigma_px: f64,
    /// Box of the object in the first image: x, y, width, height in pixels. Omit this if the detector finds the object
    /// exactly once.
    box_px: Option<[f64; 4]>,
}

/// One point of the object, in pixels of both images.
#[derive(Deserialize, ToSchema)]
#[schema(as = Click)]
#[serde(deny_unknown_fields)]
struct ClickForm {
    first_px: [f64; 2],
    second_px: [f64; 2],
}

/// The frame of the object, by the indices of three clicks, counted from 0.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[schema(as = FrameClicks)]
#[serde(deny_unknown_fields)]
struct FrameForm {
    /// Where the origin is.
    origin: usize,
    /// A point on the positive x axis.
    on_x: usize,
    /// A point of the xy plane, on the side of positive y.
    in_xy: usize,
}

fn usual_click_error() -> f64 {
    1.0
}

/// A box that something can be seen in.
fn checked_box(box_px: [f64; 4]) -> Result<BoundingBox, Failure> {
    let [x, y, width, height] = box_px;
    let usable = [x, y].iter().all(|at| at.abs() <= MAX_BOX_PX)
        && [width, height].iter().all(|side| (MIN_BOX_PX..=MAX_BOX_PX).contains(side));
    let problem = || {
        format!(
            "field 'box_px' is {box_px:?}; give x, y, width, height in pixels, sides from {MIN_BOX_PX} to {MAX_BOX_PX}"
        )
    };
    if usable { Ok(box_px.into()) } else { Err(Failure::invalid(problem())) }
}

const MIN_BOX_PX: f64 = 8.0;
const MAX_BOX_PX: f64 = 8192.0;

impl ReferenceRequest {
    /// Combines the images with their known facts.
    pub(crate) fn views(self, images: Vec<bytes::Bytes>) -> Result<Vec<KnownView>, Failure> {
        match (self.references, self.clicks) {
            (Some(references), None) => {
                let known = one_for_each(images, references, "references", "entries", "one image for each")?;
                known.map(|(image, known)| known.view(image)).collect()
            }
            (None, Some(Pairs(pairs))) => {
                let known = one_for_each(images, pairs, "clicks", "pairs", "the first image of each alone")?;
                known.map(|(image, pair)| pair.view(image)).collect()
            }
            (None, None) | (Some(_), Some(_)) => {
                Err(Failure::invalid("set either 'references' (known poses) or 'clicks' (points in two images)"))
            }
        }
    }
}

fn one_for_each<Known>(
    images: Vec<bytes::Bytes>,
    known: Vec<Known>,
    field: &str,
    entries: &str,
    send: &str,
) -> Result<impl Iterator<Item = (bytes::Bytes, Known)>, Failure> {
    if known.is_empty() {
        return Err(Failure::invalid(format!("field '{field}' is empty; give the {entries}, and {send}")));
    }
    if images.len() != known.len() {
        let (images, known) = (images.len(), known.len());
        return Err(Failure::invalid(format!(
            "{images} parts 'image' for {known} {entries} in '{field}'; send {send}"
        )));
    }
    Ok(images.into_iter().zip(known))
}

impl ReferenceImage {
    fn view(self, image: bytes::Bytes) -> Result<KnownView, Failure> {
        Ok(KnownView {
            image,
            camera: self.camera,
            pose: KnownPose::Stated(Failure::or_pose("camera_from_object", self.camera_from_object)?),
            region: self.box_px.map(checked_box).transpose()?,
        })
    }
}

impl ClicksForm {
    fn view(self, image: bytes::Bytes) -> Result<KnownView, Failure> {
        let click = |form: ClickForm| Click {
            first_px: Vector2::from(form.first_px),
            second_px: Vector2::from(form.second_px),
        };
        let FrameForm { origin, on_x, in_xy } = self.frame;
        let clicked = ClickedPose {
            second_camera: self.second_camera,
            second_from_first: Failure::or_pose("second_from_first", self.second_from_first)?,
            clicks: self.clicks.into_iter().map(click).collect(),
            sigma_px: self.sigma_px,
            frame: FrameClicks { origin, on_x, in_xy },
        };
        let region = self.box_px.map(checked_box).transpose()?;
        Ok(KnownView { image, camera: self.first_camera, pose: KnownPose::Clicked(Box::new(clicked)), region })
    }
}
