//! Several images of one scene: the request, and its answer as JSON.

use posed_core::geometry::Covariance6;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::forms::{BoxForm, CameraChoiceForm, PoseForm, PoseSchema, RawForm};
use super::report::{ImageReport, ModelsReport, PoseReport, Report, ReportContext, TimingsReport, round};
use super::transform::{PlacedReport, TransformReport};
use super::trust::{ReasonForm, StatusForm};
use crate::estimator::{Answer, CallerFrames, FusedPose, LeftOut, ViewShare};
use crate::model::Provider;
use crate::server::service::{CameraChoice, Failure, PoseRequest, ViewCamera, ViewCameras, ViewsRequest};
use crate::vision::RawLayout;

/// The part `request` of a form with several images. Set `views` or `rig`. Unknown fields are an error.
#[derive(Deserialize, ToSchema)]
#[schema(as = ViewsRequest)]
#[serde(deny_unknown_fields)]
pub(crate) struct ViewsForm {
    /// One entry for each part `image`, in the same order.
    views: Option<Vec<ViewForm>>,
    /// Id of a registered rig (`ID.rig.json` in the folder `--cameras`). Send one image for each of its cameras, in their
    /// order.
    rig: Option<String>,
    /// Pose of the rig in your world frame. Omit this to get poses in the frame of the rig.
    #[schema(value_type = Option<PoseSchema>)]
    world_from_rig: Option<PoseForm>,
    /// Names of the objects to look for. Omit this to look for all calibrated objects.
    objects: Option<Vec<String>>,
    /// Maximum number of poses of each object in each image. Omit this for no maximum.
    #[schema(minimum = 1)]
    max_instances: Option<usize>,
    /// Minimum confidence in each image, 0..1.
    #[schema(minimum = 0, maximum = 1)]
    min_confidence: Option<f64>,
    /// Whether images of another size than their camera's are its full frame, resized.
    #[serde(default)]
    allow_resize: bool,
    /// Layout of the parts `image`, if they are raw frames. Omit this for encoded images.
    raw: Option<RawForm>,
    /// Your label for the scene, such as its capture time. The answer repeats it. At most 64 characters.
    captured_at: Option<String>,
}

/// The camera of one image.
#[derive(Deserialize, ToSchema)]
#[schema(as = View)]
#[serde(deny_unknown_fields)]
struct ViewForm {
    /// Id of a registered camera, or a camera.
    #[schema(value_type = CameraChoiceForm)]
    camera: CameraChoice,
    /// Pose of the camera in your world frame.
    #[schema(value_type = PoseSchema)]
    world_from_camera: PoseForm,
    /// 6x6 covariance of `world_from_camera`, row-major: x, y, z (m²), rotation about x, y, z (rad²), along the axes of the world.
    /// Omit this for standard deviations of 1 mm and 0.1 degrees.
    covariance: Option<[[f64; 6]; 6]>,
    /// Where the objects are in this image, as in `POST /v1/poses`. Omit this to let the detector look.
    boxes: Option<Vec<BoxForm>>,
}

impl ViewsForm {
    /// Splits the form into the request and the layout of raw frames.
    pub(crate) fn translate(self) -> Result<(ViewsRequest, Option<RawLayout>), Failure> {
        let raw = self.raw.map(RawForm::layout).transpose()?;
        let Self {
            views, rig, world_from_rig, objects, max_instances, min_confidence, allow_resize, captured_at, ..
        } = self;
        let cameras = match (views, rig, world_from_rig) {
            (Some(views), None, None) => {
                let views = views.into_iter().enumerate().map(|(view, form)| form.translate(view));
                ViewCameras::Given(views.collect::<Result<_, _>>()?)
            }
            (None, Some(id), pose) => {
                let world_from_rig = pose.map(|pose| Failure::or_pose("world_from_rig", pose)).transpose()?;
                ViewCameras::Rig { id, world_from_rig }
            }
            (Some(_), Some(_), _) => return Err(Failure::invalid("set either 'views' or 'rig', not both")),
            (Some(_), None, Some(_)) => {
                return Err(Failure::invalid(
                    "field 'world_from_rig' is for 'rig'; each of 'views' has 'world_from_camera'",
                ));
            }
            (None, None, _) => {
                return Err(Failure::invalid(
                    "no cameras; set 'views' (a camera and its pose for each image), or 'rig' (an id)",
                ));
            }
        };
        // Checked before it is copied for each image.
        PoseRequest::check_names(objects.as_deref())?;
        let common =
            PoseRequest { objects, max_instances, min_confidence, allow_resize, captured_at, ..PoseRequest::default() };
        Ok((ViewsRequest { cameras, common }, raw))
    }
}

impl ViewForm {
    fn translate(self, view: usize) -> Result<ViewCamera, Failure> {
        let field = format!("views[{view}].world_from_camera");
        Ok(ViewCamera {
            camera: self.camera,
            world_from_camera: Failure::or_pose(&field, self.world_from_camera)?,
            covariance: self.covariance.map(|rows| Covariance6::from_fn(|row, column| rows[row][column])),
            boxes: BoxForm::all(self.boxes),
        })
    }
}

/// The poses of the objects that several images show.
#[derive(Debug, Serialize, ToSchema)]
pub struct ViewsReport {
    /// The frame of the poses: that of the cameras' poses.
    #[schema(example = "world: as in world_from_camera; cameras: x right, y down, z forward (OpenCV)")]
    pub frame: &'static str,
    #[schema(example = "metres, radians, pixels")]
    pub units: &'static str,
    /// Copy of `captured_at` of the request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub captured_at: Option<String>,
    /// One entry for each object. Sorted by status, then by the number of views, then by confidence.
    pub objects: Vec<FusedReport>,
    /// One entry for each image, in the order of the request: the answer to it alone.
    pub views: Vec<ViewReport>,
    pub models: ModelsReport,
}

/// The answer to one of the images alone.
#[derive(Debug, Serialize, ToSchema)]
pub struct ViewReport {
    pub image: ImageReport,
    /// As `POST /v1/poses` returns them.
    pub poses: Vec<PoseReport>,
    /// Whether objects may be missing, because the number of detections reached a limit.
    pub truncated: bool,
    /// As `POST /v1/poses` returns them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hints: Vec<String>,
    pub timings_ms: TimingsReport,
}

/// One object. Poses are absent if no view has one.
#[derive(Debug, Serialize, ToSchema)]
pub struct FusedReport {
    pub object: String,
    pub status: StatusForm,
    /// Reasons for a status other than `ok`. `views_disagree`, `single_view` and `weak_baseline` can also come with `ok`.
    pub reasons: Vec<ReasonForm>,
    /// The largest confidence of a view that the pose rests on, 0..1.
    pub confidence: f64,
    /// Pose in the world, and its covariance along the axes of the world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world_from_object: Option<PlacedReport>,
    /// The views that show the object.
    pub views: Vec<ViewShareReport>,
    /// Widest angle between the directions from which the pose is seen, degrees.
    pub view_angle_deg: f64,
    /// How much larger the views show the object than it is with `keypoints_scale`, with its standard deviation. A hint for calibration
    /// (`posed calibrate --fit-scale`); the pose does not use it. Present with three views or more from different
    /// directions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<ScaleReport>,
}

/// A factor with its standard deviation.
#[derive(Debug, Serialize, ToSchema)]
pub struct ScaleReport {
    pub value: f64,
    pub sigma: f64,
}

/// What one view has to do with a pose.
#[derive(Debug, Serialize, ToSchema)]
pub struct ViewShareReport {
    /// Place of the image in the request, from 0.
    pub view: usize,
    /// Place of the object among the `poses` of this view, from 0.
    pub pose: usize,
    /// Whether the pose rests on this view.
    pub used: bool,
    /// Why it does not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_out: Option<LeftOutForm>,
    /// Root mean square distance of the keypoints from the projection of the pose, without the outliers of a view in use.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_px: Option<f64>,
    /// Number of keypoints of this view that agree.
    pub inliers: usize,
    /// The pose as this camera sees it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_from_object: Option<TransformReport>,
}

/// Why a view is left out.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = LeftOut)]
pub enum LeftOutForm {
    /// Its keypoints are elsewhere than the other views put them.
    Contradicts,
    /// Its own pose is rejected.
    Rejected,
    /// Its camera is where the camera of a view in use is.
    NoBaseline,
}

impl From<LeftOut> for LeftOutForm {
    fn from(why: LeftOut) -> Self {
        match why {
            LeftOut::Contradicts => Self::Contradicts,
            LeftOut::Rejected => Self::Rejected,
            LeftOut::NoBaseline => Self::NoBaseline,
        }
    }
}

impl ViewsReport {
    #[must_use]
    pub fn new(answers: &[Answer], fused: &[FusedPose], provider: Provider, captured_at: Option<&str>) -> Self {
        let frames = CallerFrames::default();
        let view = |answer: &Answer| {
            let context = ReportContext { provider, frames: &frames, captured_at: None };
            let Report { image, poses, truncated, hints, timings_ms, .. } = Report::new(answer, &context);
            ViewReport { image, poses, truncated, hints, timings_ms }
        };
        // Those of the fused poses, should models have changed between two views.
        let libraries = answers.iter().map(|answer| &*answer.estimate.catalogue.library);
        let newest = libraries.max_by_key(|library| library.generation());
        Self {
            frame: "world: as in world_from_camera; cameras: x right, y down, z forward (OpenCV)",
            units: "metres, radians, pixels",
            captured_at: captured_at.map(ToOwned::to_owned),
            objects: fused.iter().map(Into::into).collect(),
            views: answers.iter().map(view).collect(),
            models: ModelsReport::new(newest, provider),
        }
    }
}

impl From<&FusedPose> for FusedReport {
    fn from(fused: &FusedPose) -> Self {
        Self {
            object: fused.object.clone(),
            status: fused.verdict.status.into(),
            reasons: fused.verdict.reasons.iter().map(Into::into).collect(),
            confidence: round(fused.confidence),
            world_from_object: fused.pose.as_ref().map(Into::into),
            views: fused.views.iter().map(Into::into).collect(),
            view_angle_deg: round(fused.view_angle_rad.to_degrees()),
            scale: fused.scale.map(|scale| ScaleReport { value: scale.value, sigma: scale.sigma }),
        }
    }
}

impl From<&ViewShare> for ViewShareReport {
    fn from(share: &ViewShare) -> Self {
        Self {
            view: share.view,
            pose: share.place,
            used: share.left_out.is_none(),
            left_out: share.left_out.map(Into::into),
            residual_px: share.residual_px.map(round),
            inliers: share.inliers,
            camera_from_object: share.camera_from_object.as_ref().map(Into::into),
        }
    }
}
