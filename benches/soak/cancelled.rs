//! Clients that leave before they have their answer, or have little time for it.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tonic::Request;

use crate::bad::came;
use crate::book::Outcome;
use crate::good::encoded;
use crate::socket::head;
use crate::world::{Client, World};

const PAUSE: Duration = Duration::from_millis(1500);

pub fn clients() -> Vec<Client> {
    vec![
        Client::new(("cancelled", "HTTP, leaves in the middle of its body"), PAUSE, |world, round| {
            leave(world, round, |length| length / 2)
        }),
        Client::new(("cancelled", "HTTP, leaves while it waits"), PAUSE, |world, round| {
            leave(world, round, |length| length)
        }),
        Client::new(("cancelled", "HTTP, has 50 to 500 ms"), PAUSE, hasty),
        Client::new(("cancelled", "gRPC, has 20 to 400 ms"), PAUSE, hasty_call),
        Client::new(("cancelled", "gRPC, leaves while it waits"), PAUSE, reset),
    ]
}

async fn soon() {
    tokio::time::sleep(Duration::from_millis(fastrand::u64(0..200))).await;
}

async fn leave(world: Arc<World>, round: usize, sent: fn(usize) -> usize) -> Outcome {
    let jpeg = &world.material.sample(round).jpeg;
    let left = async {
        let mut stream = TcpStream::connect(world.http).await?;
        stream.write_all(head("", "", jpeg.len()).as_bytes()).await?;
        stream.write_all(&jpeg[..sent(jpeg.len())]).await?;
        soon().await;
        std::io::Result::Ok(())
    };
    Outcome::Came(if left.await.is_ok() { "left" } else { "connection closed" }.into())
}

async fn hasty(world: Arc<World>, round: usize) -> Outcome {
    let jpeg = world.material.sample(round).jpeg.clone();
    let time = fastrand::u64(50..500).to_string();
    let request = world.client.post(world.url("/v1/poses?camera=demo")).header("x-request-timeout-ms", time);
    came(request.body(jpeg)).await
}

async fn hasty_call(world: Arc<World>, round: usize) -> Outcome {
    let mut request = Request::new(encoded(world.material.sample(round)));
    request.set_timeout(Duration::from_millis(fastrand::u64(20..400)));
    let answer = world.poses.clone().estimate(request).await;
    Outcome::Came(answer.map_or_else(|status| format!("{:?}", status.code()), |_| "answered".into()))
}

async fn reset(world: Arc<World>, round: usize) -> Outcome {
    let mut poses = world.poses.clone();
    let call = poses.estimate(encoded(world.material.sample(round)));
    Outcome::Came(tokio::select! {
        answer = call => answer.map_or_else(|status| format!("{:?}", status.code()), |_| "answered".into()),
        () = soon() => "left".into(),
    })
}
