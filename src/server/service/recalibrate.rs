//! A new reference for an object, in force at once.

use std::sync::Arc;
use std::time::Instant;

use posed_core::calibration::{Click, ClickedPair, FrameClicks, Mode, reference_from_clicks};
use posed_core::geometry::Pose;
use posed_core::views::Scale;
use tokio::sync::Mutex;

use super::failure::{Failure, FailureKind};
use super::options::CameraChoice;
use super::state::Service;
use crate::estimator::{
    Abandoned, BodyLease, CalibrateError, CalibrateOptions, Calibrated, KeypointsScale, Located, LocatedView,
    MeasuredView, QueueError, ReferenceWork, calibrate, no_view_twice,
};
use crate::model::{Catalogue, InForce, References};
use crate::vision::{BoundingBox, Image};

/// What is known of one reference image.
pub(crate) struct KnownView {
    pub image: bytes::Bytes,
    pub camera: CameraChoice,
    pub pose: KnownPose,
    /// By default the only one that the detector sees.
    pub region: Option<BoundingBox>,
}

/// Where the pose of the object in a reference image is known from.
pub(crate) enum KnownPose {
    /// `camera_from_object`.
    Stated(Pose),
    Clicked(Box<ClickedPose>),
}

/// Points clicked in the reference image and in a second one.
pub(crate) struct ClickedPose {
    pub second_camera: CameraChoice,
    pub second_from_first: Pose,
    pub clicks: Vec<Click>,
    pub sigma_px: f64,
    pub frame: FrameClicks,
}

/// Reference images of one object.
pub(crate) struct Recalibration {
    pub object: String,
    pub views: Vec<KnownView>,
    pub mode: Mode,
    /// Whether the origin of the object's frame may lie farther from the object than the object is large.
    pub far_origin: bool,
    /// Whether the keypoints' scale follows from these images, too. Else that in force stays.
    pub fit_scale: bool,
    /// The room that the images take.
    pub body: Arc<BodyLease>,
    pub deadline: Instant,
}

impl Service {
    /// Whether references may be replaced at all, and those of this object.
    pub(crate) fn may_recalibrate(&self, object: &str) -> Result<(), Failure> {
        self.one_at_a_time()?;
        self.model(object).map(drop)
    }

    fn one_at_a_time(&self) -> Result<&Arc<Mutex<()>>, Failure> {
        let message = "recalibration is off; start the server with --recalibration, or use `posed calibrate`";
        self.recalibration.as_ref().ok_or_else(|| Failure::new(FailureKind::Forbidden, message))
    }

    /// Measures an object's offset anew and puts it into force. With it comes what the images show of the keypoints' scale.
    pub(crate) async fn recalibrate(&self, asked: Recalibration) -> Result<(Arc<InForce>, Option<Scale>), Failure> {
        let Recalibration { object, views, mode, far_origin, fit_scale, body, deadline } = asked;
        let one_at_a_time = Arc::clone(self.one_at_a_time()?);
        // What is measured with another one is not taken for it below.
        let model = self.model(&object)?;
        let several = views.len() > 1;
        let of_image = |index: usize, Failure { kind, message }: Failure| {
            Failure::new(kind, if several { format!("image {index}: {message}") } else { message })
        };
        let stated = views.iter().enumerate().map(|(index, view)| {
            let pose = self.known_pose(view).map_err(|failure| of_image(index, failure))?;
            Ok((format!("image {index}"), pose))
        });
        let stated = stated.collect::<Result<Vec<_>, Failure>>()?;
        no_view_twice(&stated).map_err(CalibrateError::from)?;
        let turn = tokio::time::timeout_at(deadline.into(), one_at_a_time.lock_owned()).await;
        let turn = turn.map_err(|_| QueueError::from(Abandoned::Expired))?;
        let mut measured = Vec::with_capacity(views.len());
        let mut files = Vec::with_capacity(views.len());
        for (index, (view, (_, camera_from_object))) in views.into_iter().zip(stated).enumerate() {
            let file = file_name(&object, &view.image);
            let camera = self.camera(view.camera).map_err(|failure| of_image(index, failure))?;
            let work = ReferenceWork {
                image: Image::Encoded(view.image.clone()),
                body: Some(Arc::clone(&body)),
                camera: camera.clone(),
                object: object.clone(),
                region: view.region,
                deadline,
            };
            let measuring = self.queue.measure(work).await;
            let Located { region, prediction, solution } = measuring.map_err(|error| of_image(index, error.into()))?;
            let located = LocatedView { camera, camera_from_object, prediction };
            measured.push(MeasuredView { file: file.clone(), region, located, solution });
            files.push((file, view.image.to_vec()));
        }
        let (of_model, references) = (Arc::clone(&model), Arc::clone(&self.catalogue().references));
        let calibrating = tokio::task::spawn_blocking(move || {
            // A network that sees the object too large or too small does so whatever frame the object has: what was fitted of it
            // stays, even if another process did it just now.
            let scale = if fit_scale {
                KeypointsScale::Fitted
            } else {
                KeypointsScale::Stays(references.stored_scale(&of_model))
            };
            calibrate(&of_model, measured, CalibrateOptions { mode, far_origin, scale })
        });
        let calibrated = calibrating.await.map_err(|error| {
            tracing::error!(%error, "a reference could not be measured");
            Failure::new(FailureKind::Internal, "measuring the reference failed; the old one remains in use")
        })?;
        // Callers know the number of an image, not the name of its file.
        let Calibrated { reference, scale } = calibrated.map_err(|error| match error {
            CalibrateError::Measure { view, file: _, source } => {
                of_image(view, Failure::new(FailureKind::Unmeasurable, source.to_string()))
            }
            CalibrateError::Average(_) | CalibrateError::StatedPose(_) | CalibrateError::NoScale { .. } => error.into(),
        })?;
        // No change of objects may come between, or the new ones would not know of it.
        let no_change = tokio::time::timeout_at(deadline.into(), Arc::clone(&self.changing).lock_owned()).await;
        let no_change = no_change.map_err(|_| {
            Failure::new(FailureKind::TimedOut, "an object is being added or removed; measure the reference again")
        })?;
        let Catalogue { library, references } = (*self.catalogue()).clone();
        if library.object(&object).is_none_or(|now| !Arc::ptr_eq(now, &model)) {
            let message = format!("object {object:?} was replaced meanwhile; measure its reference again");
            return Err(Failure::new(FailureKind::UnknownObject, message));
        }
        let write = move || {
            // The turn ends when the files are written, even if the caller is gone by then.
            let _turns = (turn, no_change);
            references.replace(&model, &reference, &files)
        };
        let written = tokio::task::spawn_blocking(write).await;
        let failed = |error: String| {
            tracing::error!(error, "a reference could not be written");
            Failure::new(FailureKind::Internal, format!("{error}; the old reference remains in use"))
        };
        let written = written.map_err(|error| failed(error.to_string()))?;
        let in_force = written.map_err(|error| failed(error.to_string()))?;
        tracing::info!("{object} has a new reference (sha256 {})", in_force.sha256);
        Ok((in_force, scale))
    }

    fn known_pose(&self, view: &KnownView) -> Result<Pose, Failure> {
        let clicked = match &view.pose {
            KnownPose::Stated(camera_from_object) => return Ok(*camera_from_object),
            KnownPose::Clicked(clicked) => clicked,
        };
        let pair = ClickedPair {
            first_camera: &self.camera(view.camera.clone())?,
            second_camera: &self.camera(clicked.second_camera.clone())?,
            second_from_first: clicked.second_from_first,
            clicks: &clicked.clicks,
            sigma_px: clicked.sigma_px,
        };
        Ok(reference_from_clicks(&pair, clicked.frame)?.camera_from_object)
    }
}

fn file_name(object: &str, image: &[u8]) -> String {
    let format = image::guess_format(image).ok();
    let extension = format.and_then(|format| format.extensions_str().first().copied()).unwrap_or("jpg");
    References::image_name(object, image, extension)
}
