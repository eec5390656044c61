//! Clients whose requests are wrong: each is told so.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use posed::proto::EstimateRequest;
use posed::proto::estimate_request::Camera;
use reqwest::RequestBuilder;
use reqwest::multipart::Form;

use crate::book::Outcome;
use crate::good::{encoded, part};
use crate::world::{Client, World};

const PAUSE: Duration = Duration::from_secs(1);

pub fn clients() -> Vec<Client> {
    vec![
        http("HTTP, half a JPEG", |world, round| {
            let jpeg = &world.material.sample(round).jpeg;
            world.client.post(world.url("/v1/poses?camera=demo")).body(jpeg.slice(..jpeg.len() / 2))
        }),
        http("HTTP, JPEG with wrong bytes", |world, round| {
            let mut jpeg = world.material.sample(round).jpeg.to_vec();
            (0..50).for_each(|_| jpeg[fastrand::usize(2..600)] = fastrand::u8(..));
            world.client.post(world.url("/v1/poses?camera=demo")).body(jpeg)
        }),
        http("HTTP, unknown object", |world, round| {
            let url = world.url("/v1/poses?camera=demo&objects=unicorn");
            world.client.post(url).body(world.material.sample(round).jpeg.clone())
        }),
        http("HTTP, unknown camera", |world, round| {
            world.client.post(world.url("/v1/poses?camera=left")).body(world.material.sample(round).jpeg.clone())
        }),
        http("HTTP, camera without focal length", |world, round| {
            let url = world.url("/v1/poses?fx=0&fy=nan&cx=1&cy=1");
            world.client.post(url).body(world.material.sample(round).jpeg.clone())
        }),
        http("HTTP, JSON nonsense", |world, round| form(world, round, r#"{"camera": {"model": 7, "#.into())),
        http("HTTP, raw frame of another size", |world, round| {
            let url = world.url("/v1/poses?camera=demo&encoding=rgb8&width=641&height=480");
            world.client.post(url).body(world.material.sample(round).raw.clone())
        }),
        http("HTTP, no such path", |world, _| world.client.get(world.url("/v2/poses"))),
        grpc("gRPC, half a JPEG", |request| {
            let half = request.image.len() / 2;
            request.image.truncate(half);
        }),
        grpc("gRPC, no camera", |request| request.camera = None),
        grpc("gRPC, unknown camera", |request| request.camera = Some(Camera::CameraId("left".into()))),
        grpc("gRPC, no image", |request| request.image = Bytes::new()),
    ]
}

/// An image with these words as its options.
pub fn form(world: &World, round: usize, options: String) -> RequestBuilder {
    let image = part(world.material.sample(round));
    world.client.post(world.url("/v1/poses")).multipart(Form::new().part("image", image).text("request", options))
}

fn http(what: &'static str, request: impl Fn(&World, usize) -> RequestBuilder + Send + Sync + 'static) -> Client {
    Client::new(("bad", what), PAUSE, move |world, round| came(request(&world, round)))
}

/// What a request gets, whatever it is.
pub async fn came(request: RequestBuilder) -> Outcome {
    Outcome::Came(match request.send().await {
        Ok(response) => {
            let status = response.status().as_u16();
            match response.bytes().await {
                Ok(_) => status.to_string(),
                Err(_) => format!("{status}, cut off"),
            }
        }
        Err(_) => "connection closed".into(),
    })
}

fn grpc(what: &'static str, spoil: impl Fn(&mut EstimateRequest) + Send + Sync + 'static) -> Client {
    Client::new(("bad", what), PAUSE, move |world: Arc<World>, round| {
        let mut request = encoded(world.material.sample(round));
        spoil(&mut request);
        async move {
            let answer = world.poses.clone().estimate(request).await;
            Outcome::Came(answer.map_or_else(|status| format!("{:?}", status.code()), |_| "answered".into()))
        }
    })
}
