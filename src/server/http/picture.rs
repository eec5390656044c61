//! The answer as a picture.

use axum::body::Body;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse as _, Response};
use image::ImageFormat;
use mime::Mime;

use crate::estimator::Answer;
use crate::server::body::Held;
use crate::server::service::{Failure, FailureKind};
use crate::vision::encode;

/// The picture format that the caller prefers to JSON, if there is one (RFC 9110, section 12.5.1).
pub(super) fn wanted(headers: &HeaderMap) -> Option<ImageFormat> {
    let accepted: Vec<Mime> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .filter_map(|range| range.trim().parse().ok())
        .collect();
    // JSON first: it is meant where pictures are accepted no more than anything else.
    let offered = [
        (mime::APPLICATION_JSON, None),
        (mime::IMAGE_PNG, Some(ImageFormat::Png)),
        (mime::IMAGE_JPEG, Some(ImageFormat::Jpeg)),
    ];
    let mut best = (0.0, None);
    for (offer, format) in offered {
        let quality = quality(&accepted, &offer);
        if quality > best.0 {
            best = (quality, format);
        }
    }
    best.1
}

/// How much a caller wants this, 0..1, by the most specific range that holds it.
fn quality(accepted: &[Mime], offer: &Mime) -> f32 {
    let specificity = |range: &Mime| match (range.type_(), range.subtype()) {
        (mime::STAR, mime::STAR) => Some(0),
        (kind, mime::STAR) if kind == offer.type_() => Some(1),
        (kind, subtype) if (kind, subtype) == (offer.type_(), offer.subtype()) => Some(2),
        _ => None,
    };
    let ranges = accepted.iter().filter_map(|range| Some((specificity(range)?, range)));
    let best = ranges.max_by_key(|(specificity, _)| *specificity);
    best.map_or(0.0, |(_, range)| range.get_param("q").and_then(|q| q.as_str().parse().ok()).unwrap_or(1.0))
}

pub(super) fn failed(reason: &str) -> Failure {
    tracing::error!(reason, "the picture could not be drawn");
    Failure::new(FailureKind::Internal, "the server failed to draw the picture; request JSON, or see the server log")
}

/// Boxes and axes drawn into the image. Its room is kept until the picture has left.
pub(super) async fn draw(mut answer: Answer, format: ImageFormat) -> Result<Response, Failure> {
    let (mut image, room) = (answer.image.take().ok_or_else(|| failed("no pixels"))?, answer.room.take());
    // Milliseconds of work, which must not hold up other requests.
    let drawn = tokio::task::spawn_blocking(move || {
        answer.estimate.draw(&mut image);
        encode(&image, format).map(|bytes| (bytes, room))
    });
    let drawn = drawn.await.map_err(|error| failed(&error.to_string()))?;
    let (bytes, mut room) = drawn.map_err(|error| failed(&error.to_string()))?;
    if let Some(room) = &mut room {
        room.shrink_to(bytes.len() as u64);
    }
    let body = Held::body(Body::from(bytes), room);
    Ok(([(header::CONTENT_TYPE, format.to_mime_type())], body).into_response())
}
