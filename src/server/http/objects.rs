//! Objects that come and go while the server runs.

use std::io::{self, Read};
use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use bytes::{Buf as _, Bytes};
use http_body_util::BodyExt as _;
use tokio::sync::mpsc;

use super::form::{admitted, in_time, of_body};
use super::path::ObjectName;
use super::upload::Admitted;
use crate::server::api::json::{ErrorBody, ObjectReport};
use crate::server::service::{Failure, Service};

/// Serves the object of a bundle from now on, in place of the one of this name if there is one.
///
/// The body is a bundle: `NAME.posed`, as `posed-train export` writes it. The server checks it, runs its networks, and only then puts
/// it into force; other requests go on meanwhile. A bundle that cannot be served changes nothing. The server must run with
/// `--object-changes`.
#[utoipa::path(
    put,
    path = "/v1/objects/{name}",
    tag = "objects",
    params(
        ("name" = String, Path),
        ("x-request-timeout-ms" = Option<u64>, Header, description = "Time limit for the upload, milliseconds; default: `max_timeout_ms`"),
    ),
    request_body(description = "A bundle", content((Vec<u8> = "application/octet-stream"), (Vec<u8> = "application/x-tar"))),
    responses(
        (status = 200, description = "The object, as it is served now", body = ObjectReport),
        (status = 400, description = "The body is malformed", body = ErrorBody),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 403, description = "The server runs without `--object-changes`, or the token lacks the scope", body = ErrorBody),
        (status = 413, description = "The bundle exceeds `max_bundle_bytes`", body = ErrorBody),
        (status = 422, description = "The bundle is damaged, or its object cannot be served", body = ErrorBody),
        (status = 429, description = "Another object is being changed; retry after `Retry-After`", body = ErrorBody),
        (status = 500, description = "The models folder cannot be written to", body = ErrorBody),
        (status = 504, description = "The bundle did not arrive in time, or its networks took too long", body = ErrorBody),
    )
)]
pub(super) async fn put(
    State(service): State<Arc<Service>>,
    ObjectName(name): ObjectName,
    request: Request,
) -> Result<Json<ObjectReport>, Failure> {
    let turn = service.object_turn()?;
    let Admitted { deadline, .. } = admitted(&request)?;
    let (chunks, bundle) = mpsc::channel(CHUNKS);
    let upload = in_time(deadline, pour(request.into_body(), chunks));
    let (poured, put) = tokio::join!(upload, service.put_object(turn, name, Bundle::new(bundle)));
    // What stopped the upload says more than that the bundle ended early.
    poured??;
    Ok(Json(put?.into()))
}

/// Serves the object no longer, and removes its files. Its calibration in the folder of references stays.
#[utoipa::path(
    delete,
    path = "/v1/objects/{name}",
    tag = "objects",
    params(("name" = String, Path)),
    responses(
        (status = 204, description = "The object is gone"),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 403, description = "The server runs without `--object-changes`, or the token lacks the scope", body = ErrorBody),
        (status = 404, description = "The object is unknown", body = ErrorBody),
        (status = 429, description = "Another object is being changed; retry after `Retry-After`", body = ErrorBody),
        (status = 500, description = "The models folder cannot be written to", body = ErrorBody),
    )
)]
pub(super) async fn remove(
    State(service): State<Arc<Service>>,
    ObjectName(name): ObjectName,
) -> Result<StatusCode, Failure> {
    let turn = service.object_turn()?;
    service.remove_object(turn, name).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Chunks of a body that wait for the disk.
const CHUNKS: usize = 4;

enum Chunk {
    Bytes(Bytes),
    End,
}

/// Hands a body on, chunk by chunk, until whoever reads it has had enough.
async fn pour(mut body: Body, chunks: mpsc::Sender<Chunk>) -> Result<(), Failure> {
    while let Some(frame) = body.frame().await {
        let Ok(bytes) = frame.map_err(|error| of_body(&error))?.into_data() else { continue };
        if chunks.send(Chunk::Bytes(bytes)).await.is_err() {
            return Ok(());
        }
    }
    // Where it says so, it has had enough.
    let _ = chunks.send(Chunk::End).await;
    Ok(())
}

/// A body as a thread reads it that may block.
struct Bundle {
    chunks: mpsc::Receiver<Chunk>,
    rest: Bytes,
    ended: bool,
}

impl Bundle {
    fn new(chunks: mpsc::Receiver<Chunk>) -> Self {
        Self { chunks, rest: Bytes::new(), ended: false }
    }
}

impl Read for Bundle {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.rest.is_empty() && !self.ended {
            match self.chunks.blocking_recv() {
                Some(Chunk::Bytes(bytes)) => self.rest = bytes,
                Some(Chunk::End) => self.ended = true,
                None => return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the upload ended early")),
            }
        }
        let read = self.rest.len().min(buffer.len());
        self.rest.copy_to_slice(&mut buffer[..read]);
        Ok(read)
    }
}
