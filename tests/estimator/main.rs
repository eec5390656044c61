//! The pipeline and its queue on scripted networks: faults, limits and formats that real models do not show on demand.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod doubts;
mod foreign;
mod formats;
mod inputs;
mod isolation;
mod lens;
#[path = "../support/onnx.rs"]
mod onnx;
mod providers;
mod queue;
mod real;
mod script;
mod second_peaks;
mod tray;
mod trust;
mod zoom;
