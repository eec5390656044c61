//! The real server under good, bad, slow, leaving and hostile clients at once, for `SOAK_MINUTES`. Writes tables in Markdown
//! to the path in `POSED_BENCH_OUT`, or prints them. Fails if a request is lost, if memory passes the bound that the server
//! states, or if the server dies.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed measurement is no measurement")]
#![allow(unreachable_pub, reason = "for the bench alone")]

mod bad;
mod book;
mod cancelled;
mod good;
mod hostile;
#[path = "../support/numbers.rs"]
mod numbers;
mod poses;
#[path = "../support/process.rs"]
mod process;
mod report;
mod slow;
mod socket;
mod trend;
mod watch;
mod world;

use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use book::Book;
use process::Server;
use report::{Quiet, Report};
use watch::Probes;
use world::{Material, World};

const MINUTES: f64 = 30.0;
/// Frames of a stream cannot ask for more time than this, as good clients do: on a busy machine they would be late.
const SETTINGS: [&str; 2] = ["--timeout-ms", "60000"];
/// Threads that have nothing to do have ended by then, and connections whose clients are gone.
const SETTLE: Duration = Duration::from_secs(15);

fn main() -> ExitCode {
    std::env::set_current_dir(env!("CARGO_MANIFEST_DIR")).unwrap();
    let minutes = std::env::var("SOAK_MINUTES").map_or(MINUTES, |text| text.parse().unwrap());
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let report = runtime.block_on(soak(Duration::from_secs_f64(60.0 * minutes)));
    let text = report.text();
    print!("{text}");
    if let Some(path) = std::env::var_os("POSED_BENCH_OUT") {
        std::fs::write(path, text).unwrap();
    }
    if report.failures().is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

async fn soak(time: Duration) -> Report {
    let server = Server::start(&SETTINGS).await;
    let bound_mib = server.get("/v1/limits").await["memory"]["bound_bytes"].as_f64().unwrap() / f64::from(1 << 20);
    let (material, book) = (Arc::new(Material::read(&server).await), Arc::new(Book::default()));
    let warm_up = (time / 10).clamp(Duration::from_secs(20), Duration::from_mins(3));
    let soak = time.saturating_sub(warm_up);
    let probes = Probes::start(server.admin);
    let (start, mut memory) = (Instant::now(), Vec::new());

    let phases = async || {
        load(&server, &material, &book, warm_up).await;
        let warm = quiet(&server).await;
        let warm_at = start.elapsed();
        load(&server, &material, &book, soak).await;
        (warm, warm_at)
    };
    let (warm, warm_at) = tokio::select! {
        done = phases() => done,
        () = watch::memory(&server, start, &mut memory) => (None, warm_up),
    };
    let end = quiet(&server).await;
    memory.retain(|sample| sample.at >= warm_at);
    Report { warm_up, soak, book, warm, end, memory, peak: server.memory(), bound_mib, probed: probes.end() }
}

/// All clients for so long; then all their connections are closed.
async fn load(server: &Server, material: &Arc<Material>, book: &Arc<Book>, time: Duration) {
    let world = World::new(server, material, book);
    let clients = [good::clients(), slow::clients(), bad::clients(), cancelled::clients(), hostile::clients()];
    world::run(&world, clients.into_iter().flatten().collect(), time).await;
}

/// `None` once it is dead.
async fn quiet(server: &Server) -> Option<Quiet> {
    server.memory()?;
    tokio::time::sleep(SETTLE).await;
    // Before the question below opens a connection of its own.
    let (sockets, threads, mib) = (server.sockets(), server.threads(), server.memory()?.now);
    let queue = &server.get("/v1/status").await["queue"];
    let number = |name: &str| queue[name].as_u64().unwrap();
    Some(Quiet { sockets, threads, mib, images: number("images"), body_bytes: number("body_bytes") })
}
