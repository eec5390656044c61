//! The gRPC front end.

mod translate;

use tonic::{Request, Response, Status};

use super::App;
use super::failure::{Failure, FailureKind};
use crate::estimator::Work;
use crate::geometry::Camera;
use crate::proto;
use proto::estimate_request::Camera as CameraChoice;
pub(super) use proto::pose_service_server::PoseServiceServer;

/// Protocol overhead of a request beyond its image.
const MESSAGE_OVERHEAD_BYTES: usize = 4096;

pub(super) fn service(app: App) -> PoseServiceServer<Service> {
    let limit = app.max_body_bytes + MESSAGE_OVERHEAD_BYTES;
    PoseServiceServer::new(Service { app }).max_decoding_message_size(limit)
}

pub(super) struct Service {
    app: App,
}

#[tonic::async_trait]
impl proto::pose_service_server::PoseService for Service {
    async fn estimate(
        &self,
        request: Request<proto::EstimateRequest>,
    ) -> Result<Response<proto::EstimateResponse>, Status> {
        let request = request.into_inner();
        let camera = self.camera(request.camera)?;
        let answer = self.app.queue.estimate(Work { image: request.image, camera }).await.map_err(Failure::from)?;
        Ok(Response::new(answer.into()))
    }
}

impl Service {
    fn camera(&self, choice: Option<CameraChoice>) -> Result<Camera, Failure> {
        match choice {
            Some(CameraChoice::CameraId(id)) => {
                self.app.cameras.get(&id).cloned().ok_or_else(|| Failure::unknown_camera(&id, &self.app.cameras))
            }
            Some(CameraChoice::Pinhole(c)) => Ok(Camera::pinhole(c.fx, c.fy, c.cx, c.cy)?),
            None => {
                let message = "no camera: set 'camera_id' or 'pinhole'";
                Err(Failure::new(FailureKind::InvalidRequest, message))
            }
        }
    }
}

impl From<Failure> for Status {
    fn from(failure: Failure) -> Self {
        Self::new(failure.kind.grpc(), failure.message)
    }
}
