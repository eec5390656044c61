//! Listening, and what holds for every connection: how many there may be, and how long they may be silent.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use socket2::{Domain, SockRef, Socket, TcpKeepalive, Type};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio_io_timeout::TimeoutStream;

use super::open::{Counted, OpenConnections};
use super::stop::stopped;
use super::tls::Tls;

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
/// TLS holds a record in each direction, and up to 64 KiB that are still to be written.
const TLS_BUFFERS: u64 = 128 * 1024;

impl Protocol {
    /// As ALPN calls it.
    fn name(self) -> &'static [u8] {
        match self {
            Self::Http1 => b"http/1.1",
            Self::Http2 => b"h2",
        }
    }

    /// What one connection takes at most, beside the bodies that were admitted.
    pub(super) fn connection_bytes(self, tls: bool) -> u64 {
        let tls = if tls { TLS_BUFFERS } else { 0 };
        tls + match self {
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
    /// As its setting is named.
    name: &'static str,
    listener: TcpListener,
    limits: ConnectionLimits,
}

/// Connections that the system keeps for us until they are accepted.
const BACKLOG: i32 = 1024;
/// While all places are taken: how often it is looked for a connection that can be closed.
const FULL_PAUSE: Duration = Duration::from_millis(100);
/// The same trouble is told again after so long.
const TELL_PAUSE: Duration = Duration::from_secs(10);

impl Listener {
    /// Binds an address. `[::]` takes IPv4, too; where the system has no IPv6 it is `0.0.0.0`.
    pub(super) fn bind(name: &'static str, address: SocketAddr, limits: ConnectionLimits) -> std::io::Result<Self> {
        let every = address.ip() == IpAddr::V6(Ipv6Addr::UNSPECIFIED);
        let listener = match listen(address) {
            Err(_) if every && !has_ipv6() => {
                tracing::info!("no IPv6 here: {name} listens on IPv4 alone");
                listen(SocketAddr::new(Ipv4Addr::UNSPECIFIED.into(), address.port()))
            }
            bound => bound,
        }?;
        Ok(Self { name, listener, limits })
    }

    pub(super) fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Serves until the stop, and then what was asked before.
    pub(super) async fn serve(
        self,
        protocol: Protocol,
        tls: Option<Tls>,
        router: Router,
        stopping: watch::Receiver<bool>,
    ) {
        let limits = self.limits;
        let (mut door, graceful) = (Door::new(self), GracefulShutdown::new());
        let builder = Arc::new(builder(protocol, limits.idle));
        let mut stop = pin!(stopped(stopping.clone()));
        loop {
            let (stream, place) = tokio::select! {
                next = door.next() => next,
                () = &mut stop => break,
            };
            let Some(io) = prepare(stream, protocol, limits) else { continue };
            let (builder, watcher, connection) = (Arc::clone(&builder), graceful.watcher(), door.open.add());
            let (router, stopping, idle) = (router.clone(), stopping.clone(), limits.idle);
            let tls = tls.as_ref().map(|tls| tls.acceptor(protocol.name()));
            tokio::spawn(async move {
                let counted = Counted { service: router, connection: Arc::clone(&connection) };
                let service = TowerToHyperService::new(counted);
                let served = async {
                    let Some(tls) = tls else {
                        let io = TokioIo::new(io);
                        return watcher.watch(builder.serve_connection(io, service).into_owned()).await;
                    };
                    // Whoever does not finish the greeting asks nothing, either.
                    let io = TokioIo::new(tokio::time::timeout(idle, tls.accept(io)).await??);
                    watcher.watch(builder.serve_connection(io, service).into_owned()).await
                };
                tokio::select! {
                    // Clients break connections off, and send what is no HTTP: neither is a fault of ours.
                    ended = served => if let Err(error) = ended {
                        tracing::debug!(error, "a connection ended early");
                    },
                    () = connection.unwanted(stopped(stopping)) => tracing::debug!("a silent connection is closed"),
                }
                drop(place);
            });
        }
        drop(door);
        graceful.shutdown().await;
    }
}

fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, None)?;
    if address.is_ipv6() {
        socket.set_only_v6(false)?;
    }
    // A restart finds its port, though old connections linger.
    socket.set_reuse_address(true)?;
    socket.bind(&address.into())?;
    socket.listen(BACKLOG)?;
    socket.set_nonblocking(true)?;
    TcpListener::from_std(socket.into())
}

fn has_ipv6() -> bool {
    let any = SocketAddr::new(Ipv6Addr::UNSPECIFIED.into(), 0);
    Socket::new(Domain::IPV6, Type::STREAM, None).and_then(|socket| socket.bind(&any.into())).is_ok()
}

/// Where connections come in, as far as there are places.
struct Door {
    listener: Listener,
    places: Arc<Semaphore>,
    open: OpenConnections,
    told: Option<Instant>,
}

impl Door {
    fn new(listener: Listener) -> Self {
        let places = Arc::new(Semaphore::new(listener.limits.most));
        Self { listener, places, open: OpenConnections::default(), told: None }
    }

    /// The next connection, once there is a place for it. While there is none, the one that has been silent for longest is
    /// closed.
    async fn next(&mut self) -> (TcpStream, OwnedSemaphorePermit) {
        let stream = loop {
            match self.listener.listener.accept().await {
                Ok((stream, _)) => break stream,
                Err(error) => {
                    // Most often the process is out of file descriptors: others must close theirs first.
                    self.tell(|name| format!("cannot accept a connection for {name}: {error}"));
                    self.open.close_a_quiet_one();
                    tokio::time::sleep(FULL_PAUSE).await;
                }
            }
        };
        loop {
            if let Ok(place) = Arc::clone(&self.places).try_acquire_owned() {
                return (stream, place);
            }
            let most = self.listener.limits.most;
            self.tell(|name| {
                format!("all {most} connections of {name} are in use ('max_connections'): silent ones are closed, others wait")
            });
            self.open.close_a_quiet_one();
            // Whoever leaves makes room, too.
            let _ = tokio::time::timeout(FULL_PAUSE, self.places.acquire()).await;
        }
    }

    fn tell(&mut self, message: impl FnOnce(&str) -> String) {
        if self.told.is_none_or(|told| told.elapsed() > TELL_PAUSE) {
            self.told = Some(Instant::now());
            tracing::warn!("{}", message(self.listener.name));
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
