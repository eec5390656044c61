//! The calls of `posed.v1.PoseService`.

use std::sync::Arc;

use tokio::sync::watch;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use tracing::Instrument as _;

use super::answer::{estimate, estimate_views};
use super::call::Call;
use super::stream;
use crate::proto;
use crate::server::api::proto::known_object;
use crate::server::service::Service;

pub(super) struct Calls {
    pub service: Arc<Service>,
    /// True once no further frame of a stream is read.
    pub stopping: watch::Receiver<bool>,
}

#[tonic::async_trait]
impl proto::pose_service_server::PoseService for Calls {
    type EstimateStreamStream = ReceiverStream<Result<proto::EstimateStreamResponse, Status>>;

    async fn estimate(
        &self,
        request: Request<proto::EstimateRequest>,
    ) -> Result<Response<proto::EstimateResponse>, Status> {
        let call = Call::of(&request)?;
        let deadline = call.deadline.unwrap_or_else(|| self.service.deadline(None));
        let answer = estimate(&self.service, request.into_inner(), Arc::clone(&call.body), deadline).await;
        Ok(Response::new(answer.map_err(|failure| call.failed(failure))?))
    }

    async fn estimate_stream(
        &self,
        request: Request<Streaming<proto::EstimateStreamRequest>>,
    ) -> Result<Response<Self::EstimateStreamStream>, Status> {
        let (responses, stream) = tokio::sync::mpsc::channel(1);
        let frames = stream::Frames::new(Arc::clone(&self.service), Call::of(&request)?, responses);
        let run = frames.run(request.into_inner(), self.stopping.clone());
        tokio::spawn(run.instrument(tracing::Span::current()));
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn estimate_views(
        &self,
        request: Request<proto::EstimateViewsRequest>,
    ) -> Result<Response<proto::EstimateViewsResponse>, Status> {
        let call = Call::of(&request)?;
        let deadline = call.deadline.unwrap_or_else(|| self.service.deadline(None));
        let answer = estimate_views(&self.service, request.into_inner(), Arc::clone(&call.body), deadline).await;
        Ok(Response::new(answer.map_err(|failure| call.failed(failure))?))
    }

    async fn list_objects(
        &self,
        _: Request<proto::ListObjectsRequest>,
    ) -> Result<Response<proto::ListObjectsResponse>, Status> {
        let objects = self.service.objects().iter().map(known_object).collect();
        Ok(Response::new(proto::ListObjectsResponse { objects }))
    }
}
