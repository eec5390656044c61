//! The open connections of one port: which of them anybody waits for.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::http::Response;
use tokio::sync::Notify;
use tower::Service;

use super::body::Held;

/// A connection that has said nothing for so long may be closed for the sake of another one, or of a shutdown.
const QUIET: Duration = Duration::from_millis(500);

/// All of them.
#[derive(Default)]
pub(super) struct OpenConnections {
    by_age: Mutex<BTreeMap<u64, Weak<Connection>>>,
    next: AtomicU64,
}

/// One of them.
pub(super) struct Connection {
    /// Requests that are being answered.
    requests: AtomicUsize,
    quiet_since: Mutex<Instant>,
    close: Notify,
}

impl OpenConnections {
    pub(super) fn add(&self) -> Arc<Connection> {
        let (requests, quiet_since, close) = (AtomicUsize::new(0), Mutex::new(Instant::now()), Notify::new());
        let connection = Arc::new(Connection { requests, quiet_since, close });
        let mut by_age = self.by_age.lock().unwrap_or_else(PoisonError::into_inner);
        by_age.retain(|_, connection| connection.strong_count() > 0);
        by_age.insert(self.next.fetch_add(1, Ordering::Relaxed), Arc::downgrade(&connection));
        connection
    }

    /// Closes the connection that nobody has asked anything on for the longest time, if there is one.
    pub(super) fn close_a_quiet_one(&self) {
        let by_age = self.by_age.lock().unwrap_or_else(PoisonError::into_inner);
        let quiet = by_age.values().filter_map(Weak::upgrade).filter_map(|one| Some((one.quiet_since()?, one)));
        if let Some((since, connection)) = quiet.min_by_key(|(since, _)| *since)
            && since.elapsed() >= QUIET
        {
            connection.close.notify_one();
        }
    }
}

impl Connection {
    /// Waits until nobody needs it any more: another one needs its place, or the server stops and nothing is being answered
    /// on it. Half a request does not count.
    pub(super) async fn unwanted(&self, stop: impl Future<Output = ()>) {
        tokio::select! {
            () = self.close.notified() => return,
            () = stop => {}
        }
        loop {
            tokio::time::sleep(QUIET).await;
            if self.quiet_since().is_some_and(|since| since.elapsed() >= QUIET) {
                return;
            }
        }
    }

    /// Since when nothing is being answered.
    fn quiet_since(&self) -> Option<Instant> {
        let quiet = self.requests.load(Ordering::Acquire) == 0;
        quiet.then(|| *self.quiet_since.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// A request that is being answered, until its answer has left.
struct Answering(Arc<Connection>);

impl Answering {
    fn new(connection: &Arc<Connection>) -> Self {
        connection.requests.fetch_add(1, Ordering::AcqRel);
        Self(Arc::clone(connection))
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        *self.0.quiet_since.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
        self.0.requests.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Answers a connection's requests, and knows how many they are.
#[derive(Clone)]
pub(super) struct Counted<S> {
    pub service: S,
    pub connection: Arc<Connection>,
}

impl<S, R> Service<R> for Counted<S>
where
    S: Service<R, Response = Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.service.poll_ready(context)
    }

    fn call(&mut self, request: R) -> Self::Future {
        let answering = Answering::new(&self.connection);
        let answer = self.service.call(request);
        Box::pin(async move { Ok(answer.await?.map(|body| Held::body(body, answering))) })
    }
}
