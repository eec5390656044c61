//! Clients that keep to the rules: each of their requests has a right to an answer, or to a refusal that says when to come
//! again.

use std::sync::Arc;
use std::time::Duration;

use posed::proto::estimate_request::Camera;
use posed::proto::estimate_stream_request::Kind;
use posed::proto::estimate_stream_response::Result as FrameResult;
use posed::proto::{EstimateRequest, EstimateStreamRequest, Frame, RawImage, StreamSettings};
use reqwest::multipart::{Form, Part};
use serde_json::Value;
use tonic::{Code, Request, Status};
use tonic_types::StatusExt as _;

use crate::book::Outcome;
use crate::poses::Poses;
use crate::world::{Client, Sample, World};

/// Nobody here is in a hurry: what is accepted can be in time.
const TIME: Duration = Duration::from_mins(1);
const STREAM_FRAMES: usize = 4;

pub fn clients() -> Vec<Client> {
    let none = Duration::ZERO;
    vec![
        Client::new(("good", "HTTP, JPEG"), none, jpeg),
        Client::new(("good", "HTTP, raw frame"), none, raw),
        Client::new(("good", "HTTP, batch of 2"), none, batch),
        Client::new(("good", "gRPC, JPEG"), none, call),
        Client::new(("good", "gRPC, raw frame"), none, raw_call),
        Client::new(("good", "gRPC, stream of 4"), none, |world, round| stream(world, round, Duration::ZERO)),
    ]
}

async fn jpeg(world: Arc<World>, round: usize) -> Outcome {
    let sample = world.material.sample(round);
    let request = world.client.post(world.url("/v1/poses?camera=demo")).body(sample.jpeg.clone());
    judge(request, |answer| Poses::of_json(answer).agree(&sample.poses)).await
}

async fn raw(world: Arc<World>, round: usize) -> Outcome {
    let sample = world.material.sample(round);
    let Sample { width, height, .. } = sample;
    let path = format!("/v1/poses?camera=demo&encoding=rgb8&width={width}&height={height}");
    let request = world.client.post(world.url(&path)).body(sample.raw.clone());
    judge(request, |answer| Poses::of_json(answer).agree(&sample.poses)).await
}

async fn batch(world: Arc<World>, round: usize) -> Outcome {
    let samples = [world.material.sample(round), world.material.sample(round + 1)];
    let form = samples
        .iter()
        .fold(Form::new().text("request", r#"{"camera": "demo"}"#), |form, sample| form.part("image", part(sample)));
    let mut refused = None;
    let request = world.client.post(world.url("/v1/poses/batch")).multipart(form);
    let judged = judge(request, |answer| {
        let items = answer["items"].as_array().map_or(&[][..], Vec::as_slice);
        let right = |(item, sample): (&Value, &&Sample)| match item["status"].as_u64() {
            Some(200) => Poses::of_json(&item["answer"]).agree(&sample.poses),
            Some(429) => {
                refused = Some(Outcome::Refused("429 of an image".into()));
                true
            }
            _ => false,
        };
        items.len() == samples.len() && items.iter().zip(&samples).all(right)
    });
    let outcome = judged.await;
    if matches!(outcome, Outcome::Answered) { refused.unwrap_or(outcome) } else { outcome }
}

/// An image of a form.
pub fn part(sample: &Sample) -> Part {
    Part::stream_with_length(sample.jpeg.clone(), sample.jpeg.len() as u64).file_name("image.jpg")
}

/// Sends a request, and says whether its answer is one that a good client must get.
async fn judge(request: reqwest::RequestBuilder, right: impl FnOnce(&Value) -> bool) -> Outcome {
    let sent = request.header("x-request-timeout-ms", TIME.as_millis().to_string()).send().await;
    let response = match sent {
        Ok(response) => response,
        Err(error) => return Outcome::Lost(format!("broken connection: {error:?}")),
    };
    let (status, again) = (response.status(), response.headers().contains_key("retry-after"));
    let body = match response.bytes().await {
        Ok(body) => body,
        Err(error) => return Outcome::Lost(format!("broken answer: {error:?}")),
    };
    verdict(status.as_u16(), again, &body, right)
}

/// What a good client makes of an answer.
pub fn verdict(status: u16, again: bool, body: &[u8], right: impl FnOnce(&Value) -> bool) -> Outcome {
    match status {
        200 if serde_json::from_slice(body).is_ok_and(|answer: Value| right(&answer)) => Outcome::Answered,
        200 => Outcome::Lost(format!("wrong answer: {}", words(body))),
        429 | 503 if again => Outcome::Refused(status.to_string()),
        _ => Outcome::Lost(format!("{status}: {}", words(body))),
    }
}

fn words(body: &[u8]) -> String {
    String::from_utf8_lossy(body).chars().take(300).collect()
}

pub fn encoded(sample: &Sample) -> EstimateRequest {
    let camera = Some(Camera::CameraId("demo".into()));
    EstimateRequest { image: sample.jpeg.clone(), camera, ..EstimateRequest::default() }
}

async fn call(world: Arc<World>, round: usize) -> Outcome {
    let sample = world.material.sample(round);
    estimate(&world, encoded(sample), sample).await
}

async fn raw_call(world: Arc<World>, round: usize) -> Outcome {
    let sample = world.material.sample(round);
    let (encoding, data) = ("rgb8".into(), sample.raw.clone());
    let frame = RawImage { encoding, width: sample.width, height: sample.height, step: 0, data };
    let request = EstimateRequest { image: bytes::Bytes::new(), raw_image: Some(frame), ..encoded(sample) };
    estimate(&world, request, sample).await
}

async fn estimate(world: &World, request: EstimateRequest, sample: &Sample) -> Outcome {
    let mut request = Request::new(request);
    request.set_timeout(TIME);
    match world.poses.clone().estimate(request).await {
        Ok(answer) if Poses::of_response(answer.get_ref()).agree(&sample.poses) => Outcome::Answered,
        Ok(_) => Outcome::Lost("wrong answer".into()),
        Err(status) => refusal(&status),
    }
}

fn refusal(status: &Status) -> Outcome {
    if status.get_details_retry_info().is_some() {
        Outcome::Refused(format!("{:?}", status.code()))
    } else {
        Outcome::Lost(format!("{status:?}"))
    }
}

/// A stream; its client takes a while over each answer.
pub async fn stream(world: Arc<World>, round: usize, pause: Duration) -> Outcome {
    let samples: Vec<&Sample> = (0..STREAM_FRAMES).map(|frame| world.material.sample(round + frame)).collect();
    let settings = Kind::Settings(StreamSettings { window: 2, ..StreamSettings::default() });
    let frames = (0..).zip(&samples).map(|(frame_id, sample)| {
        let request = Some(encoded(sample));
        Kind::Frame(Frame { frame_id, request, capture_time: None })
    });
    let requests: Vec<_> = std::iter::once(settings).chain(frames).collect();
    let requests = futures::stream::iter(requests.into_iter().map(|kind| EstimateStreamRequest { kind: Some(kind) }));
    let mut responses = match world.poses.clone().estimate_stream(requests).await {
        Ok(responses) => responses.into_inner(),
        Err(status) => return refusal(&status),
    };
    let (mut answers, mut refused) = (0, None);
    loop {
        match responses.message().await {
            Ok(Some(response)) => match (response.result, samples.get(usize::try_from(response.frame_id).unwrap())) {
                (Some(FrameResult::Answer(answer)), Some(sample))
                    if Poses::of_response(&answer).agree(&sample.poses) => {}
                (Some(FrameResult::Error(error)), _) if error.code == Code::ResourceExhausted as i32 => {
                    refused = Some(Outcome::Refused("ResourceExhausted of a frame".into()));
                }
                (other, _) => return Outcome::Lost(format!("frame {}: {other:?}", response.frame_id)),
            },
            Ok(None) if answers == STREAM_FRAMES => return refused.unwrap_or(Outcome::Answered),
            Ok(None) => return Outcome::Lost(format!("{answers} answers to {STREAM_FRAMES} frames")),
            Err(status) => return refusal(&status),
        }
        answers += 1;
        tokio::time::sleep(pause).await;
    }
}
