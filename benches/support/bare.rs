//! The networks alone.
#![allow(dead_code, unreachable_pub, reason = "each bench uses a part of this")]

use std::path::Path;
use std::time::{Duration, Instant};

use clap::{Args as _, FromArgMatches as _};
use posed::model::{Backend as _, Input, Library, Networks, ProviderSetting, Runtime};
use posed::server::Config;
use serde_json::Value;

/// ONNX Runtime as the server loads it by default. A process loads it once.
pub fn runtime() -> Runtime {
    let runtime = Runtime::load(ProviderSetting::Auto, 1).unwrap();
    let threads = defaults(&runtime).threads();
    runtime.with_threads(threads)
}

/// The settings of a server that was given none.
pub fn defaults(runtime: &Runtime) -> Config {
    let command = Config::augment_args(clap::Command::new("posed"));
    Config::from_arg_matches(&command.get_matches_from(["posed"])).unwrap().settled(runtime.provider())
}

/// Images per second of several loops at once, as many as the server has workers.
pub fn rate(loops: &mut [BareLoop], time: Duration) -> f64 {
    std::thread::scope(|scope| {
        let running: Vec<_> = loops.iter_mut().map(|one| scope.spawn(|| one.rate(time))).collect();
        running.into_iter().map(|one| one.join().unwrap()).sum()
    })
}

pub struct BareLoop {
    networks: Networks,
    detector: ([usize; 4], Vec<u8>),
    /// Index of the network, shape and pixels of its batch.
    keypoints: Vec<(usize, [usize; 4], Vec<u8>)>,
}

impl BareLoop {
    /// With as many crops of each object as the service cuts.
    pub fn new(runtime: &Runtime, models: &Path, boxes: &[(String, usize)]) -> Self {
        let library = Library::load(models).unwrap();
        let networks = Networks::load(&library, runtime).unwrap();
        let input = &library.shared_detector().unwrap().manifest.input;
        let shape = [1, input.height as usize, input.width as usize, 3];
        let keypoints = boxes.iter().flat_map(|(name, count)| {
            let index = library.place_of(name).unwrap();
            let manifest = &library.objects[index].as_ref().unwrap().manifest;
            let side = manifest.input.size as usize;
            let first_look = manifest.second_look.map(|_| 1);
            let looks = first_look.into_iter().chain([manifest.crop_ensemble.len()]);
            looks.map(move |crops| {
                let shape = [count * crops, side, side, 3];
                (index, shape, vec![114; shape.iter().product()])
            })
        });
        Self { keypoints: keypoints.collect(), detector: (shape, vec![114; shape.iter().product()]), networks }
    }

    /// Images per second, one after another.
    pub fn rate(&mut self, time: Duration) -> f64 {
        let start = Instant::now();
        let mut images = 0.0;
        while start.elapsed() < time {
            self.run();
            images += 1.0;
        }
        images / start.elapsed().as_secs_f64()
    }

    /// Milliseconds of one image.
    pub fn run(&mut self) -> f64 {
        let start = Instant::now();
        let (shape, values) = &self.detector;
        self.networks.detectors[0].run(Input::Bytes { shape: *shape, values }).unwrap();
        for (index, shape, values) in &self.keypoints {
            let network = self.networks.keypoints[*index].as_mut().unwrap();
            network.network.run(Input::Bytes { shape: *shape, values }).unwrap();
        }
        start.elapsed().as_secs_f64() * 1e3
    }
}

/// How many boxes of each object go through its keypoint net.
pub fn boxes_by_object(answer: &Value) -> Vec<(String, usize)> {
    let mut boxes: Vec<(String, usize)> = Vec::new();
    for pose in answer["poses"].as_array().unwrap() {
        let name = pose["object"].as_str().unwrap();
        match boxes.iter_mut().find(|(object, _)| object == name) {
            Some((_, count)) => *count += 1,
            None => boxes.push((name.to_owned(), 1)),
        }
    }
    boxes
}
