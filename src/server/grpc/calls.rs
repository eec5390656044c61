//! The calls of `posed.v1.PoseService`.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::watch;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use tracing::Instrument as _;

use super::answer::{estimate, observe};
use super::stream;
use super::timeout::grpc_timeout;
use super::upload::Lease;
use crate::proto;
use crate::server::api::proto::known_object;
use crate::server::service::{Failure, FailureKind, Service};

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
        let start = Instant::now();
        let body = lease(&request)?.body;
        let answer = match grpc_timeout(request.metadata()) {
            Ok(asked) => estimate(&self.service, request.into_inner(), body, self.service.deadline(asked)).await,
            Err(failure) => Err(failure),
        };
        observe(&self.service, "Estimate", &answer, start);
        Ok(Response::new(answer?))
    }

    async fn estimate_stream(
        &self,
        request: Request<Streaming<proto::EstimateStreamRequest>>,
    ) -> Result<Response<Self::EstimateStreamStream>, Status> {
        let (responses, stream) = tokio::sync::mpsc::channel(1);
        let lease = lease(&request)?;
        let frames = stream::Frames::new(Arc::clone(&self.service), lease, responses);
        let run = frames.run(request.into_inner(), self.stopping.clone());
        tokio::spawn(run.instrument(tracing::Span::current()));
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn list_objects(
        &self,
        _: Request<proto::ListObjectsRequest>,
    ) -> Result<Response<proto::ListObjectsResponse>, Status> {
        let objects = self.service.objects().map(|object| known_object(&object)).collect();
        Ok(Response::new(proto::ListObjectsResponse { objects }))
    }
}

/// The room that a call's messages take.
fn lease<T>(request: &Request<T>) -> Result<Lease, Failure> {
    let lease = request.extensions().get::<Lease>().cloned();
    // Every call is behind `admit`.
    lease.ok_or_else(|| Failure::new(FailureKind::Internal, "the call was not admitted"))
}
