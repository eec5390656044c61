//! Every route, with its description.

use std::any::Any;
use std::sync::Arc;

use axum::extract::DefaultBodyLimit;
use axum::http::{Response, header};
use axum::response::IntoResponse as _;
use axum::routing::get;
use axum::{Router, body::Body, middleware};
use tower_http::catch_panic::CatchPanicLayer;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::failure::not_allowed;
use super::{batch, info, objects, observe, page, poses, reference, upload, views};
use crate::server::front_end::{Context, FrontEnd, Protocol};
use crate::server::service::{Failure, FailureKind, Service};

pub(in crate::server) const FRONT_END: FrontEnd = FrontEnd {
    name: "http",
    protocol: Protocol::Http1,
    address: |config| config.http,
    requests_bytes: 0,
    router: |context| Box::pin(async move { Ok(router(&context)) }),
};

fn router(context: &Context) -> Router {
    let service = Arc::clone(&context.service);
    let (router, _) = described().split_for_parts();
    router
        .route("/openapi.json", get(|| async { ([(header::CONTENT_TYPE, "application/json")], openapi()) }))
        .fallback(|| async { Failure::new(FailureKind::NotFound, "this path does not exist; see /openapi.json") })
        .method_not_allowed_fallback(not_allowed)
        // Ours is counted in `upload`.
        .layer(DefaultBodyLimit::disable())
        .layer(middleware::from_fn_with_state(Arc::clone(&service), upload::admit))
        // A browser that opens the page has no token yet, and the page no secrets.
        .merge(if context.page { page::router() } else { Router::new() })
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn_with_state(Arc::clone(&service), observe::observe))
        .with_state(service)
}

fn described() -> OpenApiRouter<Arc<Service>> {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(poses::poses))
        .routes(routes!(batch::batch))
        .routes(routes!(views::views))
        .routes(routes!(info::objects))
        .routes(routes!(info::object, objects::put, objects::remove))
        .routes(routes!(reference::replace))
        .routes(routes!(reference::image))
        .routes(routes!(info::cameras))
        .routes(routes!(info::rigs))
        .routes(routes!(info::limits))
        .routes(routes!(info::status))
}

/// The description of this interface: `docs/openapi.json`, served at `/openapi.json`.
#[must_use]
pub fn openapi() -> String {
    let mut text = described().into_openapi().to_pretty_json().unwrap_or_default();
    text.push('\n');
    text
}

#[derive(OpenApi)]
#[openapi(info(
    title = "posed",
    description = "6D poses of known rigid objects from one RGB image. Lengths are in metres, angles in radians, image \
                   coordinates in pixels. Pixel centres are at integer coordinates. The camera frame is OpenCV's: x \
                   right, y down, z forward.",
))]
struct Description;

fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response<Body> {
    drop(panic);
    tracing::error!("a handler panicked");
    Failure::new(FailureKind::Internal, "the server failed on this request; its log has the details").into_response()
}
