//! Bodies: one raw image, or a form of images and one JSON part.

use std::future::Future;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::rejection::BytesRejection;
use axum::extract::{FromRequest as _, Multipart, Request};
use axum::http::{HeaderMap, StatusCode, header};
use serde::de::DeserializeOwned;

use crate::server::Shared;
use crate::server::failure::{Failure, FailureKind};
use crate::server::request::invalid;

const TIMEOUT: &str = "x-request-timeout-ms";

/// What a form holds.
pub(super) struct Form<T> {
    /// The parts `image`, in order.
    pub images: Vec<Vec<u8>>,
    /// The part `request`.
    pub request: Option<T>,
}

/// How a body is to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Image,
    Form,
}

impl Kind {
    /// Clients that state no type, or curl's default for data, post an image.
    pub(super) fn of(headers: &HeaderMap) -> Result<Self, Failure> {
        let Some(value) = headers.get(header::CONTENT_TYPE) else { return Ok(Self::Image) };
        let stated = value.to_str().unwrap_or("unreadable").to_ascii_lowercase();
        match stated.split(';').next().unwrap_or_default().trim() {
            "multipart/form-data" => Ok(Self::Form),
            "application/octet-stream" | "application/x-www-form-urlencoded" => Ok(Self::Image),
            image if image.starts_with("image/") => Ok(Self::Image),
            other => {
                let message = format!(
                    "content type {other:?}: post the image's bytes as image/jpeg, image/png or image/webp, or \
                     multipart/form-data with the parts 'image' and 'request'"
                );
                Err(Failure::new(FailureKind::UnsupportedFormat, message))
            }
        }
    }
}

/// When the request's time is over.
pub(super) fn deadline(app: &Shared, headers: &HeaderMap) -> Result<Instant, Failure> {
    let asked = headers.get(TIMEOUT).map(|value| {
        let milliseconds = value.to_str().ok().and_then(|text| text.parse::<u64>().ok()).filter(|ms| *ms > 0);
        milliseconds.ok_or_else(|| invalid(&format!("header '{TIMEOUT}' must be a whole number of milliseconds")))
    });
    Ok(app.deadline(asked.transpose()?.map(Duration::from_millis)))
}

/// A body that is one image.
pub(super) async fn read_image(app: &Shared, request: Request, deadline: Instant) -> Result<Vec<u8>, Failure> {
    let bytes = in_time(deadline, Bytes::from_request(request, &())).await?;
    let bad =
        |rejection: BytesRejection| bad_body(rejection.status(), &rejection.body_text(), app.config.max_body_bytes);
    Ok(bytes.map_err(bad)?.into())
}

/// A body that is a form.
pub(super) async fn read_form<T: DeserializeOwned>(
    app: &Shared,
    request: Request,
    deadline: Instant,
) -> Result<Form<T>, Failure> {
    in_time(deadline, parts(app, request)).await?
}

async fn parts<T: DeserializeOwned>(app: &Shared, request: Request) -> Result<Form<T>, Failure> {
    let mut parts = Multipart::from_request(request, &()).await.map_err(|rejection| invalid(&rejection.body_text()))?;
    let mut form = Form { images: Vec::new(), request: None };
    let limit = app.config.max_body_bytes;
    let bad = |error: MultipartError| bad_part(&error, limit);
    while let Some(part) = parts.next_field().await.map_err(bad)? {
        match part.name() {
            Some("image") if form.images.len() < app.config.max_batch_images => {
                form.images.push(part.bytes().await.map_err(bad)?.into());
            }
            Some("image") => {
                let most = app.config.max_batch_images;
                let message = format!("more than {most} parts 'image' ('max_batch_images'); send fewer at once");
                return Err(Failure::new(FailureKind::TooLarge, message));
            }
            Some("request") if form.request.is_none() => form.request = Some(json(part, limit).await?),
            Some("request") => return Err(invalid("part 'request' is there twice")),
            other => {
                let name = other.unwrap_or("without a name");
                return Err(invalid(&format!("unknown part {name:?}; there are 'image' and 'request'")));
            }
        }
    }
    Ok(form)
}

async fn json<T: DeserializeOwned>(part: Field<'_>, limit: usize) -> Result<T, Failure> {
    let bytes = part.bytes().await.map_err(|error| bad_part(&error, limit))?;
    // serde_json refuses what is nested deeper than 128 levels.
    serde_json::from_slice(&bytes).map_err(|error| invalid(&format!("part 'request': {error}")))
}

/// A slow sender has no more time than the answer.
async fn in_time<T>(deadline: Instant, read: impl Future<Output = T>) -> Result<T, Failure> {
    let message = "the request's body did not arrive in time";
    tokio::time::timeout_at(deadline.into(), read).await.map_err(|_| Failure::new(FailureKind::TimedOut, message))
}

/// What axum says of a body, with our limit's name.
fn bad_body(status: StatusCode, text: &str, limit: usize) -> Failure {
    if status == StatusCode::PAYLOAD_TOO_LARGE {
        Failure::new(FailureKind::TooLarge, format!("the body is larger than {limit} bytes ('max_body_bytes')"))
    } else {
        invalid(text)
    }
}

fn bad_part(error: &MultipartError, limit: usize) -> Failure {
    bad_body(error.status(), &error.body_text(), limit)
}
