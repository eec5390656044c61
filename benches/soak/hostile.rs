//! Clients that want the server's places, memory or time.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::future::join_all;
use posed::proto::estimate_stream_request::Kind;
use posed::proto::{EstimateRequest, EstimateStreamRequest, Frame, StreamSettings};
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;

use crate::bad::{came, form};
use crate::book::Outcome;
use crate::good::encoded;
use crate::socket::{head, read};
use crate::world::{Client, World};

/// Of `max_body_bytes`, which is 16 MiB.
const TOO_LARGE: usize = 17 << 20;
/// More than `max_connections`, which is 256.
const SILENT: usize = 300;
const STALLED: usize = 6;
const STREAMS: usize = 20;
const RESETS: usize = 100;

pub fn clients() -> Vec<Client> {
    let hostile = |what, seconds| (("hostile", what), Duration::from_secs(seconds));
    let client = |(row, pause), act: fn(Arc<World>, usize) -> Act| Client::new(row, pause, act);
    vec![
        client(hostile("300 silent sockets, half of them with half a head", 10), |world, round| {
            Box::pin(silent(world, round))
        }),
        client(hostile("HTTP, body of 17 MiB", 3), |world, _| Box::pin(oversized(world))),
        client(hostile("HTTP, chunks without an end", 3), |world, _| Box::pin(endless(world))),
        client(hostile("gRPC, message of 17 MiB", 3), |world, _| Box::pin(oversized_call(world))),
        client(hostile("HTTP, 6 bodies of 15 MiB that stall", 10), |world, _| Box::pin(stalled(world))),
        client(hostile("gRPC, 20 streams at once, latest_only", 20), |world, round| Box::pin(streams(world, round))),
        client(hostile("gRPC, 100 calls, each reset at once", 10), |world, round| Box::pin(resets(world, round))),
        client(hostile("HTTP, 100,000 brackets in each other", 2), |world, round| {
            let deep = format!("{{\"camera\": {}", "[".repeat(100_000));
            Box::pin(async move { came(form(&world, round, deep)).await })
        }),
        client(hostile("HTTP, 5 million brackets in a row", 5), |world, round| {
            let wide = format!("{{\"camera\": [{}[]]}}", "[],".repeat(5_000_000));
            Box::pin(async move { came(form(&world, round, wide)).await })
        }),
        client(hostile("HTTP, PNG that claims 60000x60000", 2), |world, _| {
            let claims = include_bytes!("../../tests/data/claims-60000x60000.png");
            Box::pin(picture(world, Bytes::from_static(claims)))
        }),
        client(hostile("HTTP, PNG of 24 megapixels", 8), |world, _| {
            let bomb = world.material.bomb.clone();
            Box::pin(picture(world, bomb))
        }),
    ]
}

type Act = std::pin::Pin<Box<dyn Future<Output = Outcome> + Send>>;

async fn silent(world: Arc<World>, round: usize) -> Outcome {
    let address = if round.is_multiple_of(2) { world.http } else { world.grpc };
    let mut sockets = Vec::with_capacity(SILENT);
    for index in 0..SILENT {
        let Ok(mut stream) = TcpStream::connect(address).await else { continue };
        if index % 2 == 0 {
            // It may be closed already.
            let _ = stream.write_all(b"POST /v1/poses HTTP/1.1\r\nhost:").await;
        }
        sockets.push(stream);
    }
    tokio::time::sleep(Duration::from_secs(5)).await;
    Outcome::Came(format!("{} connected", sockets.len()))
}

async fn oversized(world: Arc<World>) -> Outcome {
    let body = world.material.zeros.slice(..TOO_LARGE);
    came(world.client.post(world.url("/v1/poses?camera=demo")).body(body)).await
}

async fn endless(world: Arc<World>) -> Outcome {
    let head =
        "POST /v1/poses?camera=demo HTTP/1.1\r\nhost: posed\r\nconnection: close\r\ntransfer-encoding: chunked\r\n\r\n";
    let block = &world.material.zeros[..1 << 20];
    let chunk = [b"100000\r\n", block, b"\r\n"].concat();
    let Ok(mut stream) = TcpStream::connect(world.http).await else { return Outcome::Came("connection closed".into()) };
    let mut sent = stream.write_all(head.as_bytes()).await;
    for _ in 0..TOO_LARGE >> 20 {
        if sent.is_ok() {
            sent = stream.write_all(&chunk).await;
        }
    }
    let answer = read(&mut stream, 8192, Duration::ZERO).await;
    Outcome::Came(answer.map_or_else(|_| "connection closed".into(), |answer| answer.status.to_string()))
}

async fn oversized_call(world: Arc<World>) -> Outcome {
    let request = EstimateRequest { image: world.material.zeros.slice(..TOO_LARGE), ..EstimateRequest::default() };
    let answer = world.own_poses().estimate(request).await;
    Outcome::Came(answer.map_or_else(|status| format!("{:?}", status.code()), |_| "answered".into()))
}

/// They take most of the room for bodies until they are cut off.
async fn stalled(world: Arc<World>) -> Outcome {
    let one = async || {
        let Ok(mut stream) = TcpStream::connect(world.http).await else { return "connection closed".to_owned() };
        let head = head("", "", 15 << 20);
        if stream.write_all(&[head.as_bytes(), b"\xFF\xD8"].concat()).await.is_err() {
            return "connection closed".to_owned();
        }
        let answer = read(&mut stream, 8192, Duration::ZERO).await;
        answer.map_or_else(|_| "connection closed".into(), |answer| answer.status.to_string())
    };
    let mut all = join_all((0..STALLED).map(|_| one())).await;
    all.sort();
    all.dedup();
    Outcome::Came(all.join(" and "))
}

async fn streams(world: Arc<World>, round: usize) -> Outcome {
    let poses = world.own_poses();
    let request = encoded(world.material.sample(round));
    let one = async || {
        let settings = Kind::Settings(StreamSettings { latest_only: true, ..StreamSettings::default() });
        let frames =
            (0..4).map(|frame_id| Kind::Frame(Frame { frame_id, request: Some(request.clone()), capture_time: None }));
        let requests: Vec<_> = std::iter::once(settings).chain(frames).collect();
        let requests = requests.into_iter().map(|kind| EstimateStreamRequest { kind: Some(kind) });
        let Ok(responses) = poses.clone().estimate_stream(futures::stream::iter(requests)).await else { return };
        let mut responses = responses.into_inner();
        while let Ok(Some(_)) = responses.message().await {}
    };
    join_all((0..STREAMS).map(|_| one())).await;
    Outcome::Came("ended".into())
}

async fn resets(world: Arc<World>, round: usize) -> Outcome {
    let poses = world.own_poses();
    let request = encoded(world.material.sample(round));
    let one = async || {
        let mut poses = poses.clone();
        let call = poses.estimate(request.clone());
        let _ = tokio::time::timeout(Duration::from_millis(fastrand::u64(0..20)), call).await;
    };
    join_all((0..RESETS).map(|_| one())).await;
    Outcome::Came("left".into())
}

async fn picture(world: Arc<World>, image: Bytes) -> Outcome {
    came(world.client.post(world.url("/v1/poses?fx=6e3&fy=6e3&cx=4e3&cy=1.5e3")).body(image)).await
}
