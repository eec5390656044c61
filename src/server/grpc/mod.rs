//! The gRPC front end.

mod stream;
mod translate;

use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::{MetadataMap, MetadataValue};
use tonic::{Request, Response, Status, Streaming};
use tracing::Instrument as _;

use super::App;
use super::failure::{Failure, FailureKind};
use super::marks::{Marks, REQUEST_ID};
use crate::proto;
pub(super) use proto::pose_service_server::PoseServiceServer;

/// Protocol overhead of a request beyond its image.
const MESSAGE_OVERHEAD_BYTES: usize = 4096;

pub(super) fn service(app: App, stopping: watch::Receiver<bool>) -> PoseServiceServer<Service> {
    let limit = app.config.max_body_bytes + MESSAGE_OVERHEAD_BYTES;
    PoseServiceServer::new(Service { app, stopping }).max_decoding_message_size(limit)
}

pub(super) struct Service {
    app: App,
    /// True once no further frame of a stream is read.
    stopping: watch::Receiver<bool>,
}

#[tonic::async_trait]
impl proto::pose_service_server::PoseService for Service {
    type EstimateStreamStream = ReceiverStream<Result<proto::EstimateStreamResponse, Status>>;

    async fn estimate(
        &self,
        request: Request<proto::EstimateRequest>,
    ) -> Result<Response<proto::EstimateResponse>, Status> {
        let Marks { id, trace_parent } = Marks::of(request.metadata().as_ref());
        let span = tracing::info_span!("grpc", id, traceparent = trace_parent, route = "Estimate");
        let work = async {
            let start = Instant::now();
            let asked = grpc_timeout(request.metadata());
            let answer = match asked {
                Ok(asked) => estimate(&self.app, request.into_inner(), self.app.deadline(asked)).await,
                Err(failure) => Err(failure),
            };
            observe(&self.app, "Estimate", &answer, start);
            answer
        };
        let mut response = Response::new(work.instrument(span).await?);
        if let Ok(value) = MetadataValue::try_from(id) {
            response.metadata_mut().insert(REQUEST_ID, value);
        }
        Ok(response)
    }

    async fn estimate_stream(
        &self,
        request: Request<Streaming<proto::EstimateStreamRequest>>,
    ) -> Result<Response<Self::EstimateStreamStream>, Status> {
        let Marks { id, trace_parent } = Marks::of(request.metadata().as_ref());
        let span = tracing::info_span!("grpc", id, traceparent = trace_parent, route = "EstimateStream");
        let (responses, stream) = tokio::sync::mpsc::channel(1);
        let frames = request.into_inner();
        tokio::spawn(stream::run(self.app.clone(), frames, responses, self.stopping.clone()).instrument(span));
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn list_objects(
        &self,
        _: Request<proto::ListObjectsRequest>,
    ) -> Result<Response<proto::ListObjectsResponse>, Status> {
        let known = self.app.library.known();
        let object = |object| translate::known_object(object, &self.app);
        Ok(Response::new(proto::ListObjectsResponse { objects: known.map(object).collect() }))
    }
}

async fn estimate(
    app: &App,
    mut request: proto::EstimateRequest,
    deadline: Instant,
) -> Result<proto::EstimateResponse, Failure> {
    let image = std::mem::take(&mut request.image);
    let options = translate::options(request, app)?;
    let answer = app.estimate(image, &options, deadline, false).await?;
    Ok(translate::response(&answer, &options, &app.models))
}

fn observe<T>(app: &App, route: &str, answer: &Result<T, Failure>, start: Instant) {
    let outcome = answer.as_ref().map_or_else(|failure| failure.kind.name(), |_| "ok");
    let duration = start.elapsed();
    app.metrics.request("grpc", route, outcome, duration);
    tracing::info!(outcome, ms = duration.as_millis());
}

/// `grpc-timeout`: up to eight digits and a unit.
fn grpc_timeout(metadata: &MetadataMap) -> Result<Option<Duration>, Failure> {
    let Some(value) = metadata.get("grpc-timeout") else { return Ok(None) };
    let parsed = value.to_str().ok().and_then(|text| {
        let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        let amount = digits.parse::<u64>().ok().filter(|_| digits.len() <= 8)?;
        match unit {
            "H" => Some(Duration::from_hours(amount)),
            "M" => Some(Duration::from_mins(amount)),
            "S" => Some(Duration::from_secs(amount)),
            "m" => Some(Duration::from_millis(amount)),
            "u" => Some(Duration::from_micros(amount)),
            "n" => Some(Duration::from_nanos(amount)),
            _ => None,
        }
    });
    let failure = || Failure::new(FailureKind::InvalidRequest, "metadata 'grpc-timeout' is no timeout");
    parsed.map(Some).ok_or_else(failure)
}

impl From<Failure> for Status {
    fn from(failure: Failure) -> Self {
        Self::new(failure.kind.grpc(), failure.message)
    }
}
