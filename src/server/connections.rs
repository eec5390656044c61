//! Listening, and what holds for every connection: how many there may be, and how long they may be silent.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use socket2::{SockRef, TcpKeepalive};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_io_timeout::TimeoutStream;

/// What a front end speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    Http1,
    Http2,
}

/// HTTP/1 reads ahead this much; a request's head must fit, too.
const HTTP1_BUFFER: usize = 32 * 1024;
/// HTTP/2: calls at a time on one connection, and what a client may send ahead of being read.
const HTTP2_STREAMS: u32 = 64;
const HTTP2_STREAM_WINDOW: u32 = 128 * 1024;
const HTTP2_CONNECTION_WINDOW: u32 = 256 * 1024;
const HTTP2_SEND_BUFFER: usize = 64 * 1024;
const HTTP2_HEADERS: u32 = 8 * 1024;

impl Protocol {
    /// What one connection takes at most, beside the bodies that were admitted.
    pub(super) fn connection_bytes(self) -> u64 {
        match self {
            // Read and write buffer, and an answer on its way.
            Self::Http1 => 3 * HTTP1_BUFFER as u64,
            // Open calls are counted by whoever answers them.
            Self::Http2 => u64::from(HTTP2_CONNECTION_WINDOW) + HTTP2_SEND_BUFFER as u64,
        }
    }
}

/// Settings of connections.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConnectionLimits {
    /// Open at a time; further ones wait to be accepted.
    pub most: usize,
    /// A client that asks nothing, or leaves a ping unanswered, for so long is cut off.
    pub idle: Duration,
    /// A client that takes none of its answer for so long is cut off.
    pub write: Duration,
}

/// A bound port.
pub(super) struct Listener {
    listener: TcpListener,
    limits: ConnectionLimits,
}

impl Listener {
    pub(super) async fn bind(address: SocketAddr, limits: ConnectionLimits) -> std::io::Result<Self> {
        Ok(Self { listener: TcpListener::bind(address).await?, limits })
    }

    pub(super) fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Serves until `stop` is over, and then what was asked before.
    pub(super) async fn serve(self, protocol: Protocol, router: Router, stop: impl Future<Output = ()>) {
        let Self { listener, limits } = self;
        let (places, open) = (Arc::new(Semaphore::new(limits.most)), GracefulShutdown::new());
        let builder = Arc::new(builder(protocol, limits.idle));
        tokio::pin!(stop);
        loop {
            let accepted = tokio::select! {
                accepted = accept(&listener, &places) => accepted,
                () = &mut stop => break,
            };
            let Some((stream, place)) = accepted else { continue };
            let Some(io) = prepare(stream, protocol, limits) else { continue };
            let (builder, router, watcher) = (Arc::clone(&builder), router.clone(), open.watcher());
            tokio::spawn(async move {
                let service = TowerToHyperService::new(router);
                let connection = builder.serve_connection(TokioIo::new(io), service).into_owned();
                // Clients break connections off, and send what is no HTTP: neither is a fault of ours.
                if let Err(error) = watcher.watch(connection).await {
                    tracing::debug!(error, "a connection ended early");
                }
                drop(place);
            });
        }
        drop(listener);
        open.shutdown().await;
    }
}

/// The next connection, once there is a place for it.
async fn accept(
    listener: &TcpListener,
    places: &Arc<Semaphore>,
) -> Option<(TcpStream, tokio::sync::OwnedSemaphorePermit)> {
    let place = Arc::clone(places).acquire_owned().await.ok()?;
    match listener.accept().await {
        Ok((stream, _)) => Some((stream, place)),
        Err(error) => {
            // Most often the process is out of file descriptors: others must close theirs first.
            tracing::warn!(%error, "cannot accept a connection");
            tokio::time::sleep(Duration::from_millis(100)).await;
            None
        }
    }
}

type Io = std::pin::Pin<Box<TimeoutStream<TcpStream>>>;

/// `None` where the client has gone already.
fn prepare(stream: TcpStream, protocol: Protocol, limits: ConnectionLimits) -> Option<Io> {
    // Answers are written whole: nothing is won by waiting for more.
    stream.set_nodelay(true).ok()?;
    // Systems count these in whole seconds.
    let [time, interval] = [limits.idle, limits.idle / 4].map(|time| time.max(Duration::from_secs(1)));
    let keepalive = TcpKeepalive::new().with_time(time).with_interval(interval);
    SockRef::from(&stream).set_tcp_keepalive(&keepalive).ok()?;
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(limits.write));
    if protocol == Protocol::Http2 {
        // Whoever is there answers pings; whoever says nothing at all, not even hello, is not.
        stream.set_read_timeout(Some(2 * limits.idle));
    }
    Some(Box::pin(stream))
}

fn builder(protocol: Protocol, idle: Duration) -> Builder<TokioExecutor> {
    let builder = Builder::new(TokioExecutor::new());
    let mut builder = match protocol {
        Protocol::Http1 => builder.http1_only(),
        Protocol::Http2 => builder.http2_only(),
    };
    // The head of the first request, and of each one after it.
    builder.http1().timer(TokioTimer::new()).header_read_timeout(idle).max_buf_size(HTTP1_BUFFER);
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(idle)
        .keep_alive_timeout(idle)
        .max_concurrent_streams(HTTP2_STREAMS)
        .initial_stream_window_size(HTTP2_STREAM_WINDOW)
        .initial_connection_window_size(HTTP2_CONNECTION_WINDOW)
        .max_send_buf_size(HTTP2_SEND_BUFFER)
        .max_header_list_size(HTTP2_HEADERS);
    builder
}
