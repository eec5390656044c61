//! Poses of objects that several images show at once.

use std::sync::Arc;
use std::time::Instant;

use posed_core::geometry::{Covariance6, Pose, is_covariance};
use tokio::task::JoinSet;

use super::boxes::RequestedBox;
use super::estimate::PoseWork;
use super::failure::{Failure, FailureKind};
use super::options::{CameraChoice, Options, PoseRequest};
use super::state::Service;
use crate::estimator::{
    Answer, BodyLease, CamerasError, Estimate, FusedPose, PixelLease, PosedCamera, ViewsPicture, cameras_are_meant,
    fuse,
};
use crate::vision::Image;

/// Cameras of one scene are no farther apart, metres: larger numbers are millimetres.
const MAX_APART_M: f64 = 50.0;
/// What a shrunk view takes until its picture has left: it, the row of all, and the encoded file.
const PICTURE_COPIES: u64 = 4;

/// The cameras of a request, in the order of its images.
#[derive(Clone, Debug)]
pub(crate) enum ViewCameras {
    Given(Vec<ViewCamera>),
    Rig { id: String, world_from_rig: Option<Pose> },
}

/// One of them.
#[derive(Clone, Debug)]
pub(crate) struct ViewCamera {
    pub camera: CameraChoice,
    pub world_from_camera: Pose,
    pub covariance: Option<Covariance6>,
    /// Of this image, in place of what detectors see.
    pub boxes: Option<Vec<RequestedBox>>,
}

/// A request as it came, translated.
#[derive(Clone, Debug)]
pub(crate) struct ViewsRequest {
    pub cameras: ViewCameras,
    /// What is wanted of each image; its camera is none.
    pub common: PoseRequest,
}

/// A request, checked.
#[derive(Clone, Debug)]
pub(crate) struct CheckedViews {
    views: Vec<(Options, PosedCamera)>,
    pub captured_at: Option<String>,
}

/// Images of one scene to be looked at.
pub(crate) struct ViewsWork {
    pub images: Vec<Image>,
    pub body: Arc<BodyLease>,
    pub checked: CheckedViews,
    /// Whether a picture is wanted.
    pub keep_images: bool,
    pub deadline: Instant,
}

/// What came of them.
pub(crate) struct ViewsAnswer {
    /// One for each image, in order; without pixels.
    pub views: Vec<Answer>,
    pub fused: Vec<FusedPose>,
    /// The images, shrunk, where they were asked for, and the room that they take.
    pub pictures: Vec<(ViewsPicture, Option<PixelLease>)>,
}

impl Service {
    /// How many images a request may have.
    pub(crate) fn check_view_count(&self, images: usize) -> Result<(), Failure> {
        let most = self.limits.max_views;
        match images {
            0 | 1 => Err(Failure::invalid(format!(
                "{images} images; this takes 2 to {most} ('max_views') of one scene. For one image use '/v1/poses'"
            ))),
            many if many > most => {
                let message = format!("{many} images, but the limit is {most} ('max_views'); send fewer views");
                Err(Failure::new(FailureKind::TooLarge, message))
            }
            _ => Ok(()),
        }
    }

    /// Checks a request for so many images against what there is.
    pub(crate) fn views(&self, request: ViewsRequest, images: usize) -> Result<CheckedViews, Failure> {
        let ViewsRequest { cameras, common } = request;
        let cameras = self.view_cameras(cameras)?;
        self.check_view_count(images.max(cameras.len()))?;
        if cameras.len() != images {
            let message =
                format!("{images} images for {} cameras; send one image for each, in their order", cameras.len());
            return Err(Failure::invalid(message));
        }
        check_places(&cameras)?;
        let captured_at = common.captured_at.clone();
        let checked = |(view, camera): (usize, ViewCamera)| {
            let ViewCamera { camera, world_from_camera, covariance, boxes } = camera;
            if covariance.as_ref().is_some_and(|covariance| !is_covariance(covariance)) {
                let message = "field 'covariance' is not a covariance: it must be finite, symmetric and without negative \
                               eigenvalues";
                return Err(Failure::invalid(message).of_view(view));
            }
            let request = PoseRequest { camera: Some(camera), boxes, ..common.clone() };
            let options = self.options(request).map_err(|failure| failure.of_view(view))?;
            Ok((options, PosedCamera { world_from_camera, covariance }))
        };
        let views = cameras.into_iter().enumerate().map(checked).collect::<Result<_, Failure>>()?;
        Ok(CheckedViews { views, captured_at })
    }

    fn view_cameras(&self, cameras: ViewCameras) -> Result<Vec<ViewCamera>, Failure> {
        let (id, world_from_rig) = match cameras {
            ViewCameras::Given(cameras) => return Ok(cameras),
            ViewCameras::Rig { id, world_from_rig } => (id, world_from_rig.unwrap_or(Pose::identity())),
        };
        let rig = self.cameras.rig(&id).ok_or_else(|| Failure::unknown_rig(&id, &self.cameras))?;
        let in_world = |camera: &crate::model::RigCamera| ViewCamera {
            camera: CameraChoice::Given(camera.camera.clone()),
            world_from_camera: world_from_rig * camera.rig_from_camera,
            boxes: None,
            covariance: camera
                .covariance
                .map(|covariance| posed_core::geometry::rotated_covariance(world_from_rig.rotation(), &covariance)),
        };
        Ok(rig.cameras.iter().map(in_world).collect())
    }

    /// Poses of what several images show. The images wait in turn, like those of a batch. One that fails fails the request.
    pub(crate) async fn estimate_views(self: &Arc<Self>, work: ViewsWork) -> Result<ViewsAnswer, Failure> {
        let ViewsWork { images, body, checked, keep_images, deadline } = work;
        let cameras: Vec<PosedCamera> = checked.views.iter().map(|(_, camera)| *camera).collect();
        let mut tasks = JoinSet::new();
        for (view, (image, (options, _))) in images.into_iter().zip(checked.views).enumerate() {
            let (service, body) = (Arc::clone(self), Arc::clone(&body));
            // Dropped with the set: with a caller that leaves, and with the first image that fails.
            tasks.spawn(async move {
                let work = PoseWork { image, body, options: &options, guide: None, keep_image: keep_images, deadline };
                let answer = service.estimate_in_turn(work).await.map_err(|failure| failure.of_view(view))?;
                Ok::<_, Failure>((view, shrunk(answer).await?))
            });
        }
        let mut all = Vec::with_capacity(tasks.len());
        while let Some(joined) = tasks.join_next().await {
            all.push(joined.map_err(|error| lost(&error))??);
        }
        all.sort_by_key(|(view, _)| *view);
        let (views, pictures): (Vec<Answer>, Vec<_>) = all.into_iter().map(|(_, answer)| answer).unzip();
        // A hostile request makes it work for tens of milliseconds.
        let fused = tokio::task::spawn_blocking(move || {
            let estimates: Vec<&Estimate> = views.iter().map(|answer| &answer.estimate).collect();
            let fused = fuse(&cameras, &estimates);
            cameras_are_meant(&cameras, &estimates, &fused)?;
            Ok::<_, CamerasError>((views, fused))
        });
        let fused = fused.await.map_err(|error| lost(&error))?;
        let (views, fused) = fused.map_err(|error| Failure::invalid(error.to_string()))?;
        Ok(ViewsAnswer { views, fused, pictures: pictures.into_iter().flatten().collect() })
    }
}

/// An answer without its image, and the image small.
async fn shrunk(mut answer: Answer) -> Result<(Answer, Option<(ViewsPicture, Option<PixelLease>)>), Failure> {
    let Some(image) = answer.image.take() else { return Ok((answer, None)) };
    let mut room = answer.room.take();
    let small = tokio::task::spawn_blocking(move || ViewsPicture::of(&image)).await.map_err(|error| lost(&error))?;
    if let Some(room) = &mut room {
        room.shrink_to(PICTURE_COPIES * small.bytes());
    }
    Ok((answer, Some((small, room))))
}

fn lost(error: &tokio::task::JoinError) -> Failure {
    tracing::error!(%error, "views could not be fused");
    Failure::new(FailureKind::Internal, "the server failed on these views; its log has the details")
}

fn check_places(cameras: &[ViewCamera]) -> Result<(), Failure> {
    for (second, camera) in cameras.iter().enumerate() {
        for (first, other) in cameras[..second].iter().enumerate() {
            let apart = (camera.world_from_camera.translation() - other.world_from_camera.translation()).norm();
            if apart > MAX_APART_M {
                return Err(Failure::invalid(format!(
                    "the cameras of views {first} and {second} are {apart:.1} m apart by their poses, more than \
                     {MAX_APART_M} m: 'translation_m' seems to be in millimetres; give metres"
                )));
            }
        }
    }
    Ok(())
}

impl Failure {
    /// Which image of several it is about.
    fn of_view(self, view: usize) -> Self {
        Self::new(self.kind, format!("view {view}: {}", self.message))
    }
}
