//! Three views of one scene as one request, against their networks alone and against three requests. Prints a table in
//! Markdown.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed measurement is no measurement")]

#[path = "../support/bare.rs"]
mod bare;
#[path = "../support/numbers.rs"]
mod numbers;
#[path = "../support/process.rs"]
mod process;

use std::path::Path;
use std::time::Instant;

use reqwest::Client;
use reqwest::multipart::{Form, Part};
use serde_json::Value;

use bare::{BareLoop, boxes_by_object, runtime};
use numbers::median;
use process::Server;

const IMAGES: [&str; 3] = ["samples/scene/view-1.jpg", "samples/scene/view-2.jpg", "samples/scene/view-3.jpg"];
/// In turns: the machine is not equally fast from one second to the next.
const ROUNDS: usize = 60;

fn main() {
    std::env::set_current_dir(env!("CARGO_MANIFEST_DIR")).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(measure());
}

async fn measure() {
    let images: Vec<Vec<u8>> = IMAGES.iter().map(|path| std::fs::read(path).unwrap()).collect();
    let server = Server::start(&[]).await;
    let (runtime, mut bare) = (runtime(), Vec::new());
    for image in &images {
        bare.push(BareLoop::new(&runtime, Path::new("models"), &boxes_by_object(&server.post(image.clone()).await)));
    }
    let (mut networks, mut single, mut views) = (Vec::new(), Vec::new(), Vec::new());
    for round in 0..=ROUNDS {
        let alone: f64 = bare.iter_mut().map(BareLoop::run).sum();
        let start = Instant::now();
        for image in &images {
            server.post(image.clone()).await;
        }
        let one_by_one = start.elapsed().as_secs_f64() * 1e3;
        let start = Instant::now();
        assert!(!fused(&server, &images).await["objects"].as_array().unwrap().is_empty());
        // The first one warms everything up.
        if round > 0 {
            views.push(start.elapsed().as_secs_f64() * 1e3);
            networks.push(alone);
            single.push(one_by_one);
        }
    }
    let ratio =
        |others: &[f64]| median(&views.iter().zip(others).map(|(views, other)| views / other).collect::<Vec<_>>());
    println!("| three 640x480 JPEGs, medians of {ROUNDS} rounds | ms | views take |\n|---|---|---|");
    println!("| their networks alone | {:.1} | {:.3} of it |", median(&networks), ratio(&networks));
    println!("| three times `POST /v1/poses` | {:.1} | {:.3} of it |", median(&single), ratio(&single));
    println!("| `POST /v1/poses/views` | {:.1} | |", median(&views));
}

async fn fused(server: &Server, images: &[Vec<u8>]) -> Value {
    let part = |image: &Vec<u8>| Part::bytes(image.clone()).file_name("image.jpg");
    let form = images.iter().fold(Form::new(), |form, image| form.part("image", part(image)));
    let url = format!("http://{}/v1/poses/views", server.http);
    let request = Client::new().post(url).multipart(form.text("request", r#"{"rig": "scene"}"#));
    let response = request.send().await.unwrap().error_for_status().unwrap();
    serde_json::from_slice(&response.bytes().await.unwrap()).unwrap()
}
