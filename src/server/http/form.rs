//! Bodies: one image, or a form of images and one JSON part.

use std::error::Error;
use std::future::Future;
use std::time::Instant;

use axum::body::HttpBody as _;
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest as _, Multipart, Request};
use axum::http::{HeaderMap, header};
use bytes::{Bytes, BytesMut};
use http_body_util::BodyExt as _;
use serde::de::DeserializeOwned;

use super::upload::{Admitted, UploadError, source_of};
use crate::server::api::json::read_request;
use crate::server::service::{Failure, FailureKind, MAX_JSON_BYTES, Service};

/// What a form holds.
pub(super) struct Form<T> {
    /// The parts `image`, in order.
    pub images: Vec<Bytes>,
    /// The part `request`.
    pub request: Option<T>,
}

/// How many parts `image` a form may have, and the setting that says so.
#[derive(Clone, Copy)]
pub(super) struct ImageLimit {
    pub most: usize,
    pub setting: &'static str,
}

impl ImageLimit {
    pub(super) fn of_batch(service: &Service) -> Self {
        Self { most: service.limits.max_batch_images, setting: "max_batch_images" }
    }
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
                    "content type {other:?} is not supported; post an image as image/jpeg, image/png or image/webp, a raw \
                     frame as application/octet-stream, or multipart/form-data with the parts 'image' and 'request'"
                );
                Err(Failure::new(FailureKind::UnsupportedFormat, message))
            }
        }
    }
}

/// The room of a request's body, and its time.
pub(super) fn admitted(request: &Request) -> Result<Admitted, Failure> {
    // Every route that reads a body is behind `admit`.
    let missing = || Failure::new(FailureKind::Internal, "the body was not admitted");
    request.extensions().get::<Admitted>().cloned().ok_or_else(missing)
}

/// A body that is one image.
pub(super) async fn read_image(request: Request, deadline: Instant) -> Result<Bytes, Failure> {
    let mut body = request.into_body();
    // As much as it states, which was admitted; nothing is resident before it has come.
    let stated = body.size_hint().exact().and_then(|bytes| usize::try_from(bytes).ok()).unwrap_or(0);
    let read = async {
        let mut bytes = BytesMut::with_capacity(stated);
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|error| of_body(&error))?;
            bytes.extend_from_slice(frame.data_ref().map_or(&[], AsRef::as_ref));
        }
        Ok(bytes.freeze())
    };
    in_time(deadline, read).await?
}

/// A body that is a form.
pub(super) async fn read_form<T: DeserializeOwned>(
    limit: ImageLimit,
    request: Request,
    deadline: Instant,
) -> Result<Form<T>, Failure> {
    match Kind::of(request.headers())? {
        Kind::Form => in_time(deadline, parts(limit, request)).await?,
        Kind::Image => {
            let message = "this path takes multipart/form-data with the parts 'image' and 'request'";
            Err(Failure::new(FailureKind::UnsupportedFormat, message))
        }
    }
}

async fn parts<T: DeserializeOwned>(limit: ImageLimit, request: Request) -> Result<Form<T>, Failure> {
    let parts = Multipart::from_request(request, &()).await;
    let mut parts = parts.map_err(|rejection| Failure::invalid(rejection.body_text()))?;
    let mut form = Form { images: Vec::new(), request: None };
    while let Some(part) = parts.next_field().await.map_err(|error| of_part(&error))? {
        match part.name() {
            Some("image") if form.images.len() < limit.most => {
                form.images.push(part.bytes().await.map_err(|error| of_part(&error))?);
            }
            Some("image") => {
                let ImageLimit { most, setting } = limit;
                let message = format!("more than {most} parts 'image' ('{setting}'); send fewer at once");
                return Err(Failure::new(FailureKind::TooLarge, message));
            }
            Some("request") if form.request.is_none() => form.request = Some(json(part).await?),
            Some("request") => return Err(Failure::invalid("part 'request' appears twice; send it once")),
            other => {
                let name = other.unwrap_or("without a name");
                return Err(Failure::invalid(format!("unknown part {name:?}; use 'image' and 'request'")));
            }
        }
    }
    Ok(form)
}

async fn json<T: DeserializeOwned>(mut part: Field<'_>) -> Result<T, Failure> {
    let mut text = BytesMut::new();
    while let Some(chunk) = part.chunk().await.map_err(|error| of_part(&error))? {
        if text.len() + chunk.len() > MAX_JSON_BYTES {
            let message = format!("part 'request' exceeds the limit of {MAX_JSON_BYTES} bytes ('max_json_bytes')");
            return Err(Failure::new(FailureKind::TooLarge, message));
        }
        text.extend_from_slice(&chunk);
    }
    // serde_json refuses what is nested deeper than 128 levels.
    read_request(&text)
}

/// A slow sender has no more time than the answer.
pub(super) async fn in_time<T>(deadline: Instant, read: impl Future<Output = T>) -> Result<T, Failure> {
    let message = "the request body did not arrive in time; raise 'x-request-timeout-ms', or send less";
    tokio::time::timeout_at(deadline.into(), read).await.map_err(|_| Failure::new(FailureKind::TimedOut, message))
}

fn of_part(error: &MultipartError) -> Failure {
    of_source(error).unwrap_or_else(|| Failure::invalid(error.body_text()))
}

pub(super) fn of_body(error: &axum::Error) -> Failure {
    of_source(error).unwrap_or_else(|| Failure::invalid(error.to_string()))
}

/// What stopped a body, somewhere under what its readers say.
fn of_source(error: &(dyn Error + 'static)) -> Option<Failure> {
    source_of::<UploadError>(error).map(Failure::from)
}

/// A form of at most two images, as an upload brings it.
#[cfg(fuzzing)]
pub(in crate::server) async fn fuzz_form(bytes: &[u8]) {
    let request = Request::builder().header(header::CONTENT_TYPE, "multipart/form-data; boundary=b");
    let Ok(request) = request.body(axum::body::Body::from(bytes.to_vec())) else { return };
    let limit = ImageLimit { most: 2, setting: "max_batch_images" };
    let soon = Instant::now() + std::time::Duration::from_secs(5);
    let _ = read_form::<crate::server::api::json::EstimateRequest>(limit, request, soon).await;
}
