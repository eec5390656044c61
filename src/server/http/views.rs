//! `POST /v1/poses/views`.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header;
use axum::response::{IntoResponse as _, Response};
use image::ImageFormat;

use super::form::{self, Form, ImageLimit};
use super::picture::{self, failed};
use super::poses::image;
use super::upload::Admitted;
use crate::estimator::ViewsPicture;
use crate::server::api::json::{ErrorBody, ViewsForm, ViewsReport};
use crate::server::body::Held;
use crate::server::service::{Failure, Service, ViewsAnswer, ViewsWork};
use crate::vision::encode;

/// Returns one pose for each object that several images of one scene show, in the frame that the cameras' poses are known in.
///
/// The images must show the scene at one moment, or a scene that stands still. Views that contradict the others are left out
/// and named. An object that one image shows is answered as that image alone has it. The images wait like those of a
/// batch; if one fails, the request fails.
#[utoipa::path(
    post,
    path = "/v1/poses/views",
    tag = "poses",
    params(
        ("x-request-timeout-ms" = Option<u64>, Header, description = "Time limit for the answer, milliseconds"),
        ("accept" = Option<String>, Header, description = "`image/png` or `image/jpeg` for a picture of all views side by side"),
    ),
    request_body(
        description = "A form with one part `image` for each view, in order, and a part `request`",
        content((ViewsForm = "multipart/form-data"))
    ),
    responses(
        (status = 200, description = "The poses; an empty list if no object is in view", body = ViewsReport),
        (status = 400, description = "An image, a camera, a pose or an option is not usable", body = ErrorBody),
        (status = 401, description = "The server needs a token, and there is none, or an unknown one", body = ErrorBody),
        (status = 403, description = "The token lacks the scope", body = ErrorBody),
        (status = 404, description = "A camera, the rig or an object is unknown", body = ErrorBody),
        (status = 409, description = "A requested object is not calibrated", body = ErrorBody),
        (status = 413, description = "The body or an image exceeds a limit, or there are too many images", body = ErrorBody),
        (status = 415, description = "An image format or the content type is not supported", body = ErrorBody),
        (
            status = 429,
            description = "The server is out of room, or the answer would come too late; retry after `Retry-After`",
            body = ErrorBody
        ),
        (status = 500, description = "The server failed on these images", body = ErrorBody),
        (status = 503, description = "All workers have failed or hang", body = ErrorBody),
        (status = 504, description = "The time limit expired, or the body stalled", body = ErrorBody),
    )
)]
pub(super) async fn views(State(service): State<Arc<Service>>, request: Request) -> Result<Response, Failure> {
    let picture = picture::wanted(request.headers());
    let Admitted { body, deadline } = form::admitted(&request)?;
    let limit = ImageLimit { most: service.limits.max_views, setting: "max_views" };
    let Form { images, request } = form::read_form::<ViewsForm>(limit, request, deadline).await?;
    service.check_view_count(images.len())?;
    let request = request.ok_or_else(|| Failure::invalid("no part 'request'; send one that sets 'views' or 'rig'"))?;
    let (request, raw) = request.translate()?;
    let checked = service.views(request, images.len())?;
    let captured_at = checked.captured_at.clone();
    let images = images.into_iter().map(|bytes| image(bytes, raw)).collect::<Result<_, _>>()?;
    let work = ViewsWork { images, body, checked, keep_images: picture.is_some(), deadline };
    let answer = service.estimate_views(work).await?;
    if let Some(format) = picture {
        return draw(answer, format).await;
    }
    let report = ViewsReport::new(&answer.views, &answer.fused, service.provider, captured_at.as_deref());
    Ok(Json(report).into_response())
}

/// All views in a row, with what was found in them. Their room is kept until the picture has left.
async fn draw(answer: ViewsAnswer, format: ImageFormat) -> Result<Response, Failure> {
    let ViewsAnswer { views, fused, pictures } = answer;
    let (pictures, room): (Vec<ViewsPicture>, Vec<_>) = pictures.into_iter().unzip();
    let drawn = tokio::task::spawn_blocking(move || {
        let each = pictures.into_iter().zip(&views).enumerate();
        let drawn: Vec<_> =
            each.map(|(view, (picture, answer))| picture.drawn(view, &answer.estimate, &fused)).collect();
        encode(&ViewsPicture::side_by_side(&drawn), format)
    });
    let drawn = drawn.await.map_err(|error| failed(&error.to_string()))?;
    let bytes = drawn.map_err(|error| failed(&error.to_string()))?;
    let body = Held::body(Body::from(bytes), room);
    Ok(([(header::CONTENT_TYPE, format.to_mime_type())], body).into_response())
}
