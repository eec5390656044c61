//! Tracks, on simulated streams of which everything is known.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod filter;
mod identity;
mod simulation;
mod times;
