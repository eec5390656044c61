//! What it costs to add an object to a server that is asked all the time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use reqwest::StatusCode;

use crate::bundle::Bundle;
use crate::objects::{Folders, keep_asking, put, remove};

/// Not a test: what a hot add costs. `make hot-add` prints it.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "prints figures"]
async fn figures_of_a_hot_add() {
    let folders = Folders::without_cube();
    let server = folders.serve(&["--object-changes"]);
    let stop = Arc::new(AtomicBool::new(false));
    let asking = keep_asking(&server, &stop);
    tokio::time::sleep(Duration::from_secs(10)).await;
    let (mut adds, bundle) = (Vec::new(), Bundle::of("cube").tar());
    for _ in 0..10 {
        let start = Instant::now();
        assert_eq!(put(&server, "cube", bundle.clone()).await.status(), StatusCode::OK);
        adds.push((start, start.elapsed()));
        assert_eq!(remove(&server, "cube").await, StatusCode::NO_CONTENT);
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    stop.store(true, Ordering::Relaxed);
    let times = asking.await.unwrap();
    let during = |(began, took): &(Instant, Duration)| {
        adds.iter().any(|(start, time)| *began < *start + *time && *start < *began + *took)
    };
    let before = |(began, _): &(Instant, Duration)| *began < adds[0].0;
    let sorted = |some: &dyn Fn(&(Instant, Duration)) -> bool| {
        let mut times: Vec<Duration> = times.iter().filter(|one| some(one)).map(|(_, took)| *took).collect();
        times.sort();
        times
    };
    let quantile = |times: &[Duration], percent: usize| times[(times.len() * percent / 100).min(times.len() - 1)];
    let (alone, beside) = (sorted(&before), sorted(&during));
    let slowest = adds.iter().map(|(_, took)| *took).max().unwrap();
    println!("hot add to live: slowest of {} {slowest:.0?}", adds.len());
    println!("requests: {}, none lost", times.len());
    for (name, times) in [("without", &alone), ("beside", &beside)] {
        let [p50, p99] = [50, 99].map(|percent| quantile(times, percent));
        println!("{name} an add: {} requests, p50 {p50:.0?}, p99 {p99:.0?}", times.len());
    }
}
