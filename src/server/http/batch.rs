//! `POST /v1/poses/batch`.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::{Request, State};
use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;
use utoipa::ToSchema;

use super::body::{self, Form};
use super::poses::report;
use super::{ErrorBody, ErrorDetail};
use crate::server::App;
use crate::server::api::json::Report;
use crate::server::failure::{Failure, FailureKind};
use crate::server::request::{EstimateRequest, invalid};

/// One set of options for all images, or one for each.
#[derive(Deserialize)]
#[serde(transparent)]
pub(super) struct BatchRequest(serde_json::Value);

/// One entry for each image, in the order of the form.
#[derive(Serialize, ToSchema)]
pub(super) struct BatchReport {
    items: Vec<ItemReport>,
}

/// The answer to one image: `answer` or `error`.
#[derive(Serialize, ToSchema)]
struct ItemReport {
    /// HTTP status that this image alone would have had.
    status: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    answer: Option<Report>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<ErrorDetail>,
}

/// The poses in several images. Each image is admitted, answered or refused on its own.
#[utoipa::path(
    post,
    path = "/v1/poses/batch",
    tag = "poses",
    params(("x-request-timeout-ms" = Option<u64>, Header, description = "Time for the whole answer, within the server's limit")),
    request_body(
        description = "Parts `image`, one for each image, and one part `request`: an `EstimateRequest` for all images, or a list with one \
                       for each",
        content((EstimateRequest = "multipart/form-data"))
    ),
    responses(
        (status = 200, description = "One entry for each image, with its own status", body = BatchReport),
        (status = 400, description = "No form, no image, or options that do not fit the images", body = ErrorBody),
        (status = 413, description = "The body is larger than a limit, or holds too many images", body = ErrorBody),
        (status = 504, description = "The body did not arrive in time", body = ErrorBody),
    )
)]
pub(super) async fn batch(State(app): State<App>, request: Request) -> Result<Json<BatchReport>, Failure> {
    let deadline = body::deadline(&app, request.headers())?;
    let Form { images, request } = body::read_form::<BatchRequest>(&app, request, deadline).await?;
    if images.is_empty() {
        return Err(invalid("no part 'image'; at least one is needed"));
    }
    let requests = request.ok_or_else(|| invalid("no part 'request'; it names the camera"))?.for_each(images.len())?;
    let mut tasks = JoinSet::new();
    for (index, (image, request)) in images.into_iter().zip(requests).enumerate() {
        let app = Arc::clone(&app);
        // Dropped with the set, and so with a caller that leaves.
        tasks.spawn(async move { (index, one(&app, image, request, deadline).await) });
    }
    let mut items: Vec<(usize, ItemReport)> = Vec::with_capacity(tasks.len());
    while let Some(joined) = tasks.join_next().await {
        let (index, answer) =
            joined.map_err(|error| Failure::new(FailureKind::Internal, format!("an image was lost: {error}")))?;
        items.push((index, answer.into()));
    }
    items.sort_by_key(|(index, _)| *index);
    Ok(Json(BatchReport { items: items.into_iter().map(|(_, item)| item).collect() }))
}

async fn one(
    app: &App,
    image: Vec<u8>,
    request: Result<EstimateRequest, Failure>,
    deadline: Instant,
) -> Result<Report, Failure> {
    let options = request?.check(app)?;
    let answer = app.estimate(image, &options, deadline, false).await?;
    Ok(report(app, &answer, &options))
}

impl BatchRequest {
    fn for_each(self, images: usize) -> Result<Vec<Result<EstimateRequest, Failure>>, Failure> {
        let parse = |json: serde_json::Value| {
            serde_json::from_value(json).map_err(|error| invalid(&format!("part 'request': {error}")))
        };
        let list = match self.0 {
            serde_json::Value::Array(list) => list,
            shared @ (serde_json::Value::Null
            | serde_json::Value::Bool(_)
            | serde_json::Value::Number(_)
            | serde_json::Value::String(_)
            | serde_json::Value::Object(_)) => vec![shared; images],
        };
        if list.len() != images {
            return Err(invalid(&format!("part 'request' lists {} options for {images} images", list.len())));
        }
        Ok(list.into_iter().map(parse).collect())
    }
}

impl From<Result<Report, Failure>> for ItemReport {
    fn from(answer: Result<Report, Failure>) -> Self {
        match answer {
            Ok(report) => Self { status: 200, answer: Some(report), error: None },
            Err(failure) => {
                let ErrorBody { error } = ErrorBody::from(&failure);
                Self { status: failure.kind.http().as_u16(), answer: None, error: Some(error) }
            }
        }
    }
}
