//! The service against a bare loop over its networks, and at twice its capacity. Writes a table in Markdown to the path
//! in `POSED_BENCH_OUT`, or prints it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed measurement is no measurement")]

#[path = "../support/bare.rs"]
mod bare;
mod load;
#[path = "../support/numbers.rs"]
mod numbers;
#[path = "../support/process.rs"]
mod process;

use std::fmt::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use posed::model::{ProviderSetting, Runtime, available_cores};
use posed::server::Config;
use serde_json::Value;

use bare::{BareLoop, boxes_by_object, defaults, rate, runtime};
use load::{Overload, closed_loop, overload};
use numbers::{median, spread};
use process::Server;

const SAMPLE: &str = "samples/sample-1.jpg";
/// Many short ones: the two sides of a ratio are measured within seconds of each other, since the machine that they
/// share with others is not equally fast from one half-minute to the next.
const ROUNDS: usize = 15;
const ROUND: Duration = Duration::from_millis(2500);
/// Images of a round that the bare loop and one client answer in turns.
const PAIRS: usize = 12;
const OVERLOAD: Duration = Duration::from_mins(1);
/// Enough to keep every stage busy, and no more than the queue holds.
const CLIENTS: usize = 8;

fn main() {
    std::env::set_current_dir(env!("CARGO_MANIFEST_DIR")).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(measure());
}

async fn measure() {
    let image = std::fs::read(SAMPLE).unwrap();
    let mut starts: Vec<f64> = Vec::new();
    for _ in 0..5 {
        starts.push(Server::start(&[]).await.started_s);
    }
    let server = Server::start(&[]).await;
    let answer = server.post(image.clone()).await;
    let idle = server.idle_cpu_percent().await;
    let rss_start = server.rss_mib();

    let runtime = runtime();
    let boxes = boxes_by_object(&answer);
    let defaults = defaults(&runtime);
    let one = |_| BareLoop::new(&runtime, Path::new("models"), &boxes);
    let mut bare: Vec<BareLoop> = (0..defaults.workers()).map(one).collect();
    let mut baseline = Baseline::of(&runtime, &boxes);
    let (mut bare_ms, mut alone_ms, mut stages) = (Vec::new(), Vec::new(), Vec::new());
    let (mut bare_rates, mut rates) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        bare_rates.push(rate(&mut bare, ROUND));
        rates.push(closed_loop(&server, &image, CLIENTS, ROUND).await);
        for _ in 0..PAIRS {
            bare_ms.push(bare[0].run());
            let start = Instant::now();
            let answer = server.post(image.clone()).await;
            alone_ms.push(start.elapsed().as_secs_f64() * 1e3);
            stages.push(answer["timings_ms"].clone());
        }
        if let Some(baseline) = &mut baseline {
            baseline.compare(&server, &image).await;
        }
    }
    // The clients were there for half a minute and more, in all rounds together.
    let rss_busy = server.rss_mib();
    let capacity = median(&rates);
    let over = overload(&server, &image, 2.0 * capacity, OVERLOAD).await;
    let report = Report {
        defaults,
        starts,
        idle,
        rss_start,
        rss_busy,
        bare_ms,
        alone_ms,
        stages,
        bare_rates,
        rates,
        baseline,
        over,
        answer,
    };
    let text = report.text();
    print!("{text}");
    if let Some(path) = std::env::var_os("POSED_BENCH_OUT") {
        std::fs::write(Path::new(&path), text).unwrap();
    }
}

/// What one request cost before: a bare loop over earlier networks on the CPU provider, against today's service.
struct Baseline {
    /// For all objects, and for one.
    loops: [(Vec<String>, BareLoop); 2],
    /// For each, milliseconds of the loop and of the service, in turns.
    pairs: [Vec<(f64, f64)>; 2],
}

impl Baseline {
    /// With the models in `POSED_BASELINE`.
    fn of(runtime: &Runtime, boxes: &[(String, usize)]) -> Option<Self> {
        let models = std::env::var_os("POSED_BASELINE")?;
        let cpu = runtime.with(ProviderSetting::Cpu, available_cores()).unwrap();
        let one = &boxes[..1];
        let alone = |boxes: &[(String, usize)]| BareLoop::new(&cpu, Path::new(&models), boxes);
        let loops = [(Vec::new(), alone(boxes)), (vec![one[0].0.clone()], alone(one))];
        Some(Self { loops, pairs: [Vec::new(), Vec::new()] })
    }

    async fn compare(&mut self, server: &Server, image: &[u8]) {
        for ((objects, bare), pairs) in self.loops.iter_mut().zip(&mut self.pairs) {
            let objects: Vec<&str> = objects.iter().map(String::as_str).collect();
            for _ in 0..PAIRS {
                let before = bare.run();
                let start = Instant::now();
                server.post_for(image.to_vec(), &objects).await;
                pairs.push((before, start.elapsed().as_secs_f64() * 1e3));
            }
        }
    }

    fn text(&self, boxes: usize) -> String {
        let row = |objects: usize, pairs: &[(f64, f64)]| {
            let (before, now): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
            let ratios: Vec<f64> = pairs.iter().map(|(before, now)| now / before).collect();
            format!("| {objects} | {:.1} | {:.1} | **{:.2}** |", median(&before), median(&now), median(&ratios))
        };
        format!(
            "\n## Against 32-bit networks\n\nOne client, against a bare loop over the networks before they computed in 8 bits, with \
             three crops in the second look instead of two, on ONNX Runtime's CPU provider.\n\n\
             | objects | bare loop, ms | `POST /v1/poses`, ms | ratio |\n|---|---|---|---|\n{}\n{}\n",
            row(1, &self.pairs[1]),
            row(boxes, &self.pairs[0])
        )
    }
}

struct Report {
    defaults: Config,
    starts: Vec<f64>,
    idle: f64,
    rss_start: f64,
    rss_busy: f64,
    bare_ms: Vec<f64>,
    alone_ms: Vec<f64>,
    stages: Vec<Value>,
    bare_rates: Vec<f64>,
    rates: Vec<f64>,
    baseline: Option<Baseline>,
    over: Overload,
    answer: Value,
}

impl Report {
    fn text(&self) -> String {
        let boxes: usize = boxes_by_object(&self.answer).iter().map(|(_, count)| count).sum();
        let (rate, bare_rate) = (median(&self.rates), median(&self.bare_rates));
        let (alone, bare) = (median(&self.alone_ms), median(&self.bare_ms));
        let ratios: Vec<f64> = self.rates.iter().zip(&self.bare_rates).map(|(rate, bare)| rate / bare).collect();
        let rest: Vec<f64> = self.alone_ms.iter().zip(&self.bare_ms).map(|(alone, bare)| alone - bare).collect();
        let mut text = String::new();
        let line = |text: &mut String, name: &str, value: String| writeln!(text, "| {name} | {value} |").unwrap();
        writeln!(
            text,
            "# Serving\n\n`make bench-serve`: the real server and its clients share {} cores. One 640x480 JPEG ({} KB) with {boxes} detected boxes, \
             {} workers of {} threads. Bare loops, as many as workers, and service take turns: {ROUNDS} rounds of {} s each with {CLIENTS} clients, and {PAIRS} pairs of \
             single images in each round. Medians; those of ratio and difference are of neighbours. A bare loop runs the same \
             sessions on the same shapes with the same threads, and does nothing else.\n\n| | |\n|---|---|",
            std::thread::available_parallelism().map_or(0, usize::from),
            std::fs::metadata(SAMPLE).unwrap().len() / 1000,
            self.defaults.workers(),
            self.defaults.threads(),
            ROUND.as_secs_f64()
        )
        .unwrap();
        line(&mut text, "bare loop over the networks, images/s", format!("{bare_rate:.2}"));
        line(&mut text, &format!("`POST /v1/poses`, {CLIENTS} clients, images/s"), format!("{rate:.2}"));
        line(&mut text, "ratio", format!("**{:.3}**", median(&ratios)));
        line(&mut text, "bare loop, ms an image", format!("{bare:.2}"));
        line(&mut text, "one client, ms an image", format!("{alone:.2}"));
        line(
            &mut text,
            "one client beside a bare loop, which takes objects one after the other, ms",
            format!("**{:.2}**", median(&rest)),
        );
        for stage in ["decode", "detect", "keypoints", "pnp", "queue"] {
            let times: Vec<f64> = self.stages.iter().map(|timings| timings[stage].as_f64().unwrap()).collect();
            line(&mut text, &format!("stage `{stage}`, ms"), format!("{:.2}", median(&times)));
        }
        line(&mut text, "start to ready, s", format!("{:.2}", median(&self.starts)));
        line(&mut text, "idle, % of a core", format!("{:.2}", self.idle));
        line(&mut text, "resident memory after the first answer, MiB", format!("{:.0}", self.rss_start));
        let clients =
            format!("resident memory after {CLIENTS} clients for {:.0} s, MiB", ROUNDS as f64 * ROUND.as_secs_f64());
        line(&mut text, &clients, format!("**{:.0}**", self.rss_busy));
        if let Some(baseline) = &self.baseline {
            text.push_str(&baseline.text(boxes));
        }
        let over = &self.over;
        let goodput = over.answered as f64 / OVERLOAD.as_secs_f64();
        writeln!(
            text,
            "\n## Twice the capacity\n\n{:.1} requests/s for {} s, sent at fixed times whatever the server does.\n\n| | |\n|---|---|",
            over.rate,
            OVERLOAD.as_secs()
        )
        .unwrap();
        line(&mut text, "answered, images/s", format!("{goodput:.2}"));
        line(&mut text, "share of the capacity", format!("**{:.3}**", goodput / rate));
        line(&mut text, "refused with 429", over.refused_ms.len().to_string());
        line(&mut text, "any other outcome", over.others.to_string());
        line(&mut text, "refusal, p50 / p99 / most, ms", spread(&over.refused_ms));
        line(&mut text, "answer, p50 / p99 / most, ms", spread(&over.answered_ms));
        // An image waits for the queue before it, and for the batch that it is answered with.
        let bound = 18.0 / rate * 1e3;
        line(&mut text, "a full queue (16) and a batch (2) take, ms", format!("{bound:.0}"));
        line(
            &mut text,
            "resident memory, first and last quarter, MiB",
            format!("{:.0} / {:.0}", over.rss_early, over.rss_late),
        );
        text
    }
}
