//! A new reference for an object, in force at once.

use std::sync::Arc;
use std::time::Instant;

use posed_core::calibration::Mode;
use posed_core::geometry::Pose;
use tokio::sync::Mutex;

use super::failure::{Failure, FailureKind};
use super::options::CameraChoice;
use super::state::Service;
use crate::estimator::{BodyLease, MeasuredView, ReferenceWork, calibrate};
use crate::model::{ObjectModel, Reference};
use crate::vision::{BoundingBox, Image};

/// What is known of one reference image.
pub(crate) struct KnownView {
    pub image: bytes::Bytes,
    pub camera: CameraChoice,
    pub camera_from_object: Pose,
    /// By default the only one that the detector sees.
    pub region: Option<BoundingBox>,
}

/// Reference images of one object.
pub(crate) struct Recalibration {
    pub object: String,
    pub views: Vec<KnownView>,
    pub mode: Mode,
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

    fn one_at_a_time(&self) -> Result<&Mutex<()>, Failure> {
        let message = "recalibration is off; start the server with --recalibration, or use `posed calibrate`";
        self.recalibration.as_ref().ok_or_else(|| Failure::new(FailureKind::Forbidden, message))
    }

    /// Measures an object's offset anew and puts it into force.
    pub(crate) async fn recalibrate(&self, asked: Recalibration) -> Result<Reference, Failure> {
        let Recalibration { object, views, mode, body, deadline } = asked;
        let one_at_a_time = self.one_at_a_time()?;
        let model = self.model(&object)?;
        let _turn = one_at_a_time.lock().await;
        let mut measured = Vec::with_capacity(views.len());
        let mut files = Vec::with_capacity(views.len());
        for (index, view) in views.into_iter().enumerate() {
            let file = file_name(&object, index, &view.image);
            let camera = self.camera(view.camera)?;
            let work = ReferenceWork {
                image: Image::Encoded(view.image.clone()),
                body: Some(Arc::clone(&body)),
                camera: camera.clone(),
                object: object.clone(),
                region: view.region,
                deadline,
            };
            let (region, solution) = self.queue.measure(work).await?;
            let camera_from_object = view.camera_from_object;
            measured.push(MeasuredView { file: file.clone(), camera, camera_from_object, region, solution });
            files.push((file, view.image.to_vec()));
        }
        self.put_into_force(model, measured, files, mode).await
    }

    async fn put_into_force(
        &self,
        model: &ObjectModel,
        views: Vec<MeasuredView>,
        files: Vec<(String, Vec<u8>)>,
        mode: Mode,
    ) -> Result<Reference, Failure> {
        let reference = calibrate(model, views, mode)?;
        let (references, new) = (Arc::clone(&self.references), reference.clone());
        let written = tokio::task::spawn_blocking(move || references.replace(new, &files)).await;
        let failed = |error: String| {
            tracing::error!(error, "a reference could not be written");
            Failure::new(FailureKind::Internal, format!("{error}; the old reference remains in use"))
        };
        written.map_err(|error| failed(error.to_string()))?.map_err(|error| failed(error.to_string()))?;
        tracing::info!("{} has a new reference", reference.object);
        Ok(reference)
    }
}

fn file_name(object: &str, index: usize, image: &[u8]) -> String {
    let format = image::guess_format(image).ok();
    let extension = format.and_then(|format| format.extensions_str().first().copied()).unwrap_or("jpg");
    format!("{object}-{index}.{extension}")
}
