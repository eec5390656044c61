//! Clients.
#![allow(unreachable_pub, reason = "for the bench alone")]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use reqwest::StatusCode;
use tokio::task::JoinSet;

use crate::process::Server;

/// What an overload did.
pub struct Overload {
    pub rate: f64,
    pub answered: usize,
    pub answered_ms: Vec<f64>,
    pub refused_ms: Vec<f64>,
    pub others: usize,
    pub rss_early: f64,
    pub rss_late: f64,
}

/// Images per second of so many clients that each wait for their answer.
pub async fn closed_loop(server: &Server, image: &[u8], clients: usize, time: Duration) -> f64 {
    let (start, answered) = (Instant::now(), Arc::new(AtomicUsize::new(0)));
    let mut tasks = JoinSet::new();
    for _ in 0..clients {
        let (request, answered) = (server.request(image.to_vec()), Arc::clone(&answered));
        tasks.spawn(async move {
            while start.elapsed() < time {
                let response = request.try_clone().unwrap().send().await.unwrap();
                assert_eq!(response.status(), StatusCode::OK);
                response.bytes().await.unwrap();
                answered.fetch_add(1, Ordering::Relaxed);
            }
        });
    }
    tasks.join_all().await;
    answered.load(Ordering::Relaxed) as f64 / start.elapsed().as_secs_f64()
}

/// Requests at fixed times, whatever becomes of them.
pub async fn overload(server: &Server, image: &[u8], rate: f64, time: Duration) -> Overload {
    let (start, mut tasks) = (Instant::now(), JoinSet::new());
    let mut memory = Vec::new();
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(rate.recip()));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Burst);
    while start.elapsed() < time {
        ticks.tick().await;
        let request = server.request(image.to_vec());
        tasks.spawn(async move {
            let start = Instant::now();
            let response = request.send().await.unwrap();
            let status = response.status();
            response.bytes().await.unwrap();
            (status, start.elapsed().as_secs_f64() * 1e3)
        });
        memory.push(server.rss_mib());
    }
    let mut over = Overload {
        rate,
        answered: 0,
        answered_ms: Vec::new(),
        refused_ms: Vec::new(),
        others: 0,
        rss_early: mean(&memory[..memory.len() / 4]),
        rss_late: mean(&memory[3 * memory.len() / 4..]),
    };
    for (status, milliseconds) in tasks.join_all().await {
        match status {
            StatusCode::OK => over.answered_ms.push(milliseconds),
            StatusCode::TOO_MANY_REQUESTS => over.refused_ms.push(milliseconds),
            _ => over.others += 1,
        }
    }
    over.answered = over.answered_ms.len();
    over
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
