//! Clients that are slow within the limits: they have the same rights as good ones.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;

use crate::book::Outcome;
use crate::good::{stream, verdict};
use crate::poses::Poses;
use crate::socket::{drip, head, narrow, read};
use crate::world::{Client, World};

const PIECE: usize = 8192;

pub fn clients() -> Vec<Client> {
    let second = Duration::from_secs(1);
    vec![
        Client::new(("slow", "HTTP, body in drips for 3 s"), second, upload),
        Client::new(("slow", "HTTP, picture read in drips"), second, picture),
        Client::new(("slow", "gRPC, stream read in drips"), second, move |world, round| {
            stream(world, round, second / 2)
        }),
    ]
}

async fn upload(world: Arc<World>, round: usize) -> Outcome {
    let sample = world.material.sample(round);
    let head = head("", "x-request-timeout-ms: 60000\r\n", sample.jpeg.len());
    let asked = async {
        let mut stream = TcpStream::connect(world.http).await.map_err(|error| error.to_string())?;
        stream.write_all(head.as_bytes()).await.map_err(|error| error.to_string())?;
        let sent = drip(&mut stream, &sample.jpeg, 12, Duration::from_millis(250)).await;
        // A refusal may come before the upload has ended.
        let answer = read(&mut stream, PIECE, Duration::ZERO).await;
        answer.map_err(|error| format!("{error}; upload: {sent:?}"))
    };
    match asked.await {
        Ok(answer) => {
            let right = |answer: &serde_json::Value| Poses::of_json(answer).agree(&sample.poses);
            verdict(answer.status, answer.again, &answer.body, right)
        }
        Err(error) => Outcome::Lost(error),
    }
}

async fn picture(world: Arc<World>, round: usize) -> Outcome {
    let sample = world.material.sample(round);
    let head = head("", "x-request-timeout-ms: 60000\r\naccept: image/png\r\n", sample.jpeg.len());
    let asked = async {
        let mut stream = narrow(world.http).await.map_err(|error| error.to_string())?;
        stream.write_all(head.as_bytes()).await.map_err(|error| error.to_string())?;
        stream.write_all(&sample.jpeg).await.map_err(|error| error.to_string())?;
        read(&mut stream, PIECE, Duration::from_millis(50)).await
    };
    match asked.await {
        Ok(answer) if answer.status == 200 => match image::load_from_memory(&answer.body) {
            Ok(_) => Outcome::Answered,
            Err(error) => Outcome::Lost(format!("no picture: {error}")),
        },
        Ok(answer) => verdict(answer.status, answer.again, &answer.body, |_| false),
        Err(error) => Outcome::Lost(error),
    }
}
