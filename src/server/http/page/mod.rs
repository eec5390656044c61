//! The page for people at `/`: files that are part of the program. It uses the API as any client does.

mod files;

use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::failure::not_allowed;
use crate::server::service::{Failure, FailureKind};
use files::{File, INDEX, file, tag};

/// Nothing from elsewhere, no script or style in the text, in no frame of another page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; \
                      trusted-types 'none'";

/// Headers of every file. A browser asks whether its copy is still right, so a new server has its new page at once.
const HEADERS: [(HeaderName, &str); 5] = [
    (header::CACHE_CONTROL, "no-cache"),
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("permissions-policy"), "camera=(self), microphone=(), geolocation=()"),
];

/// Everything but the page itself lies under `/page/`, off the paths of the API.
pub(super) fn router<S: Clone + Send + Sync + 'static>() -> Router<S> {
    Router::new()
        .route("/", get(|headers: HeaderMap| async move { answer(&INDEX, &headers) }))
        .route("/page/{*name}", get(named))
        .method_not_allowed_fallback(not_allowed)
}

async fn named(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Failure> {
    let missing = || Failure::new(FailureKind::NotFound, "the page has no such file; it is at /");
    file(&name).map(|file| answer(file, &headers)).ok_or_else(missing)
}

fn answer(file: &File, request: &HeaderMap) -> Response {
    let tag = tag();
    let known = request.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    let known = known.flat_map(|value| value.split(',')).any(|value| [tag, "*"].contains(&value.trim()));
    let headers = (HEADERS, [(header::ETAG, tag)]);
    if known {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    (headers, [(header::CONTENT_TYPE, file.content_type())], file.bytes).into_response()
}
