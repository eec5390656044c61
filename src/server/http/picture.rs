//! The answer as a picture.

use axum::body::Body;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse as _, Response};
use image::ImageFormat;

use crate::estimator::Answer;
use crate::server::body::Held;
use crate::server::service::{Failure, FailureKind};
use crate::vision::encode;

/// The first picture format that the caller accepts, if it names one.
pub(super) fn wanted(headers: &HeaderMap) -> Option<ImageFormat> {
    let accepted = headers.get(header::ACCEPT)?.to_str().ok()?;
    accepted.split(',').find_map(|range| match range.split(';').next().unwrap_or_default().trim() {
        "image/png" => Some(ImageFormat::Png),
        "image/jpeg" => Some(ImageFormat::Jpeg),
        _ => None,
    })
}

/// Boxes and axes drawn into the image. Its room is kept until the picture has left.
pub(super) async fn draw(mut answer: Answer, format: ImageFormat) -> Result<Response, Failure> {
    let failed = |reason: String| {
        tracing::error!(reason, "the picture could not be drawn");
        Failure::new(
            FailureKind::Internal,
            "the server failed to draw the picture; request JSON, or see the server log",
        )
    };
    let (mut image, room) = (answer.image.take().ok_or_else(|| failed("no pixels".into()))?, answer.room.take());
    // Milliseconds of work, which must not hold up other requests.
    let drawn = tokio::task::spawn_blocking(move || {
        answer.estimate.draw(&mut image);
        encode(&image, format).map(|bytes| (bytes, room))
    });
    let drawn = drawn.await.map_err(|error| failed(error.to_string()))?;
    let (bytes, mut room) = drawn.map_err(|error| failed(error.to_string()))?;
    if let Some(room) = &mut room {
        room.shrink_to(bytes.len() as u64);
    }
    let body = Held::body(Body::from(bytes), room);
    Ok(([(header::CONTENT_TYPE, format.to_mime_type())], body).into_response())
}
