//! What holds for every call: how many there may be, how long they may take, and that each is counted.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::middleware::Next;
use axum::response::Response;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::Status;
use tracing::Instrument as _;

use super::call::Call;
use super::failure::outcome;
use super::route::Route;
use super::timeout::{expired, grpc_timeout};
use super::until::{Until, shutting_down};
use super::upload::Messages;
use crate::server::body::Held;
use crate::server::front_end::Context;
use crate::server::observe::span;
use crate::server::pending::Pending;
use crate::server::service::{Failure, FailureKind};
use crate::server::stop::stopped;

/// Open calls on all connections; each takes memory even if nothing comes.
pub(super) const MAX_CALLS: usize = 2048;
/// The longest time that a stream can ask for: beyond it there is no end.
const LONGEST: Duration = Duration::from_hours(24 * 365);

/// What calls are admitted by.
#[derive(Clone)]
pub(super) struct Admitting {
    context: Arc<Context>,
    /// Of a message, bytes.
    limit: usize,
    calls: Arc<Semaphore>,
}

impl Admitting {
    pub(super) fn new(context: &Arc<Context>, limit: usize) -> Self {
        Self { context: Arc::clone(context), limit, calls: Arc::new(Semaphore::new(MAX_CALLS)) }
    }

    fn call(&self, route: Route, headers: &HeaderMap) -> Result<(Call, OwnedSemaphorePermit), Failure> {
        let full = |_| {
            let message = format!("{MAX_CALLS} calls are open already; try again in a moment");
            Failure::new(FailureKind::QueueFull, message)
        };
        let service = &self.context.service;
        if let Some(scope) = route.needs() {
            service.access.check(headers.get(header::AUTHORIZATION).map(HeaderValue::as_bytes), scope)?;
        }
        let place = Arc::clone(&self.calls).try_acquire_owned().map_err(full)?;
        let asked = grpc_timeout(headers)?;
        let deadline = match (route.is_single(), asked) {
            (true, asked) => Some(service.deadline(asked)),
            // These may last.
            (false, asked) => asked.filter(|asked| *asked < LONGEST).map(|asked| Instant::now() + asked),
        };
        Ok((Call::new(service.lease(), deadline), place))
    }

    /// Runs a call until it is answered, or its time is over.
    async fn run(self, route: Route, call: &Call, request: Request, next: Next) -> Response {
        let (mut parts, body) = request.into_parts();
        parts.extensions.insert(call.clone());
        let body = Messages::body(body, call.clone(), route, &self.context.service, self.limit);
        let stop = || stopped(self.context.stopping.clone());
        tokio::select! {
            biased;
            response = next.run(Request::from_parts(parts, body)) => match route {
                Route::Health | Route::Other => response.map(|body| Until::body(body, stop())),
                Route::Estimate | Route::EstimateStream | Route::EstimateViews | Route::ListObjects => response,
            },
            () = expired(call.deadline) => {
                let message = "the time limit of the call expired; raise it, or send less";
                Status::from(call.failed(Failure::new(FailureKind::TimedOut, message))).into_http()
            }
            () = stop(), if !route.is_ours() => shutting_down().into_http(),
        }
    }
}

/// Admits a call, keeps its time, and counts it.
pub(super) async fn admit(State(admitting): State<Admitting>, request: Request, next: Next) -> Response {
    let route = Route::of(request.uri().path());
    let span = span("grpc", &request, route.name());
    let service = &admitting.context.service;
    let pending = Pending::new(service, "grpc", route.name(), route.is_for_poses(), span.clone());
    let (call, place) = match admitting.call(route, request.headers()) {
        Ok(admitted) => admitted,
        Err(failure) => {
            pending.answered(failure.kind.name(), None);
            return Status::from(failure).into_http();
        }
    };
    let response = admitting.run(route, &call, request, next).instrument(span).await;
    let said = || Status::from_header_map(response.headers()).map_or("ok", |status| outcome(&status));
    match call.failure().map_or_else(said, FailureKind::name) {
        // Its frames are counted one by one.
        "ok" if route == Route::EstimateStream => pending.forget(),
        outcome => pending.answered(outcome, None),
    }
    // Until the answer has left: a client that does not read it has no room for more.
    response.map(|body| Held::body(body, (call, place)))
}
