//! `POST /v1/poses/batch`.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::{Request, State};
use bytes::Bytes;
use serde::Serialize;
use tokio::task::JoinSet;
use utoipa::ToSchema;

use super::failure::status;
use super::form::{self, Form, ImageLimit};
use super::poses::{image, report};
use super::upload::Admitted;
use crate::estimator::BodyLease;
use crate::server::api::json::{BatchRequest, ErrorBody, ErrorDetail, EstimateRequest, Report};
use crate::server::service::{Failure, FailureKind, PoseWork, Service};

/// One item for each image, in the order of the form.
#[derive(Serialize, ToSchema)]
pub(super) struct BatchReport {
    items: Vec<ItemReport>,
}

/// The result for one image: `answer` or `error`.
#[derive(Serialize, ToSchema)]
struct ItemReport {
    /// HTTP status that `POST /v1/poses` returns for this image.
    status: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    answer: Option<Report>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<ErrorDetail>,
}

/// Returns the poses in several images. Each image has its own status.
///
/// The images of batches leave a quarter of the queue to single images.
#[utoipa::path(
    post,
    path = "/v1/poses/batch",
    tag = "poses",
    params(("x-request-timeout-ms" = Option<u64>, Header, description = "Time limit for the whole answer, milliseconds")),
    request_body(
        description = "A form with one part `image` for each image and one part `request`. The part `request` is an \
                       `EstimateRequest` for all images, or a list with one for each image",
        content((EstimateRequest = "multipart/form-data"))
    ),
    responses(
        (status = 200, description = "One item for each image, with its own status", body = BatchReport),
        (status = 400, description = "The form or one of its values is not usable", body = ErrorBody),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 403, description = "The token lacks the scope", body = ErrorBody),
        (status = 413, description = "The body exceeds a limit, or has too many images", body = ErrorBody),
        (status = 415, description = "The body is not a form", body = ErrorBody),
        (
            status = 429,
            description = "The server is out of room, or the answer would come too late; retry after `Retry-After`",
            body = ErrorBody
        ),
        (status = 500, description = "The server failed on this request", body = ErrorBody),
        (status = 503, description = "All workers have failed or hang", body = ErrorBody),
        (status = 504, description = "The body did not arrive in time, or stalled", body = ErrorBody),
    )
)]
pub(super) async fn batch(State(service): State<Arc<Service>>, request: Request) -> Result<Json<BatchReport>, Failure> {
    let Admitted { body, deadline } = form::admitted(&request)?;
    let Form { images, request } =
        form::read_form::<BatchRequest>(ImageLimit::of_batch(&service), request, deadline).await?;
    if images.is_empty() {
        return Err(Failure::invalid("no part 'image'; send at least one"));
    }
    let request = request.ok_or_else(|| Failure::invalid("no part 'request'; send one that sets the camera"))?;
    let requests = request.for_each(images.len())?;
    let mut tasks = JoinSet::new();
    for (index, (image, request)) in images.into_iter().zip(requests).enumerate() {
        let (service, body) = (Arc::clone(&service), Arc::clone(&body));
        // Dropped with the set, and so with a caller that leaves.
        tasks.spawn(async move { (index, one(&service, image, body, request, deadline).await) });
    }
    let mut items: Vec<(usize, ItemReport)> = Vec::with_capacity(tasks.len());
    while let Some(joined) = tasks.join_next().await {
        let lost = |error| Failure::new(FailureKind::Internal, format!("the server failed on an image: {error}"));
        let (index, answer) = joined.map_err(lost)?;
        items.push((index, answer.into()));
    }
    items.sort_by_key(|(index, _)| *index);
    Ok(Json(BatchReport { items: items.into_iter().map(|(_, item)| item).collect() }))
}

async fn one(
    service: &Service,
    bytes: Bytes,
    body: Arc<BodyLease>,
    request: Result<EstimateRequest, Failure>,
    deadline: Instant,
) -> Result<Report, Failure> {
    let (asked, raw) = request?.translate()?;
    let options = service.options(asked)?;
    let image = image(bytes, raw)?;
    let work = PoseWork { image, body, options: &options, guide: None, keep_image: false, deadline };
    let answer = service.estimate_in_turn(work).await?;
    Ok(report(service, &answer, &options))
}

impl From<Result<Report, Failure>> for ItemReport {
    fn from(answer: Result<Report, Failure>) -> Self {
        match answer {
            Ok(report) => Self { status: 200, answer: Some(report), error: None },
            Err(failure) => {
                let ErrorBody { error } = ErrorBody::from(&failure);
                Self { status: status(failure.kind).as_u16(), answer: None, error: Some(error) }
            }
        }
    }
}
