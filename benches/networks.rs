//! The networks alone: what they cost on every provider that runs here, with one thread and with all. Writes a table in
//! Markdown to the path in `POSED_BENCH_OUT`, or prints it. `POSED_BASELINE`: a folder of models to compare with.
#![allow(clippy::unwrap_used, reason = "a failed measurement is no measurement")]

#[path = "support/numbers.rs"]
mod numbers;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use posed::model::{Input, Library, Networks, ProviderSetting, Runtime, available_cores};

use numbers::median;

/// All in turns: the machine is not equally fast from one second to the next.
const ROUNDS: usize = 60;
const PROVIDERS: [ProviderSetting; 4] =
    [ProviderSetting::Cpu, ProviderSetting::Openvino, ProviderSetting::Cuda, ProviderSetting::Tensorrt];

struct Candidate {
    models: &'static str,
    runs_on: String,
    networks: Networks,
    detector: [usize; 4],
    side: usize,
    crops: usize,
    place: usize,
    /// Milliseconds of the detector, one crop, the crops of a further look, and many crops.
    times: [Vec<f64>; 4],
    /// Keypoints of the trainer's crops.
    keypoints: Vec<f32>,
}

const MANY: usize = 16;

fn main() {
    std::env::set_current_dir(env!("CARGO_MANIFEST_DIR")).unwrap();
    let runtime = Runtime::load(ProviderSetting::Cpu, 1).unwrap();
    let mut folders = vec![("these models", PathBuf::from("models"))];
    folders.extend(std::env::var_os("POSED_BASELINE").map(|folder| ("in 32 bits", PathBuf::from(folder))));
    let mut threads = vec![1, available_cores()];
    threads.dedup();
    let mut candidates = Vec::new();
    for (name, folder) in &folders {
        for provider in PROVIDERS {
            for &threads in &threads {
                match Candidate::load(&runtime, name, folder, provider, threads) {
                    Ok(candidate) => candidates.push(candidate),
                    Err(reason) => eprintln!("{provider:?}: left out: {reason}"),
                }
            }
        }
    }
    let crops = image::open(folders[0].1.join("cube/parity.png")).unwrap().into_rgb8().into_raw();
    for _ in 0..ROUNDS {
        for candidate in &mut candidates {
            candidate.measure(&crops);
        }
    }
    let text = text(&candidates);
    print!("{text}");
    if let Some(path) = std::env::var_os("POSED_BENCH_OUT") {
        std::fs::write(Path::new(&path), text).unwrap();
    }
}

impl Candidate {
    fn load(
        runtime: &Runtime,
        models: &'static str,
        folder: &Path,
        provider: ProviderSetting,
        threads: usize,
    ) -> Result<Self, String> {
        let library = Library::load(folder).map_err(|error| error.to_string())?;
        let runtime = runtime.with(provider, threads).map_err(|error| error.to_string())?;
        let networks = Networks::load(&library, &runtime).map_err(|error| error.to_string())?;
        let input = &library.shared_detector().unwrap().manifest.input;
        let place = library.place_of("cube").unwrap();
        let object = &library.objects[place].as_ref().unwrap().manifest;
        let plural = if threads == 1 { "" } else { "s" };
        Ok(Self {
            models,
            runs_on: format!("{provider:?}, {threads} thread{plural}").to_lowercase(),
            networks,
            detector: [1, input.height as usize, input.width as usize, 3],
            side: object.input.size as usize,
            crops: object.crop_ensemble.len(),
            place,
            times: Default::default(),
            keypoints: Vec::new(),
        })
    }

    fn measure(&mut self, crops: &[u8]) {
        let shape = |count| [count, self.side, self.side, 3];
        let shapes = [self.detector, shape(1), shape(self.crops), shape(MANY)];
        for (shape, times) in shapes.into_iter().zip(&mut self.times) {
            let values: Vec<u8> = crops.iter().copied().cycle().take(shape.iter().product()).collect();
            let network = if shape == self.detector {
                &mut self.networks.detectors[0]
            } else {
                &mut self.networks.keypoints[self.place].as_mut().unwrap().network
            };
            let start = Instant::now();
            let outputs = network.run(Input::Bytes { shape, values: &values }).unwrap();
            times.push(start.elapsed().as_secs_f64() * 1e3);
            if shape[0] == MANY {
                self.keypoints.clone_from(&outputs.named("keypoints").unwrap().values);
            }
        }
    }

    /// Pixels between these keypoints and another's, in the median.
    fn apart(&self, other: &Self) -> f64 {
        let pairs = self.keypoints.chunks_exact(2).zip(other.keypoints.chunks_exact(2));
        median(&pairs.map(|(a, b)| f64::from((a[0] - b[0]).hypot(a[1] - b[1]))).collect::<Vec<_>>())
    }
}

fn text(candidates: &[Candidate]) -> String {
    let mut text = format!(
        "# The networks on each provider\n\n`make bench-networks`: the demo's detector (448x352) and one keypoint net (160x160), \
         milliseconds, medians of {ROUNDS} rounds in which all take turns, on a machine with {} cores. \"In 32 bits\" are the \
         networks before they were quantised, which cut three crops for a further look, not two. The last column is how far \
         keypoints lie from where the last line of the table sees them, in the median.\n\n\
         | networks | provider | detector | one crop | crops of a further look | {MANY} crops | keypoints apart, px |\n\
         |---|---|---|---|---|---|---|\n",
        available_cores()
    );
    for candidate in candidates {
        let [detector, one, all, many] = candidate.times.each_ref().map(|times| median(times));
        let apart = candidates.last().map_or(0.0, |last| candidate.apart(last));
        let (models, runs_on, crops) = (candidate.models, &candidate.runs_on, candidate.crops);
        let row = format!("{detector:.1} | {one:.1} | {all:.1} ({crops}) | {many:.1} | {apart:.2}");
        writeln!(text, "| {models} | {runs_on} | {row} |").unwrap();
    }
    text
}
