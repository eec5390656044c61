//! The commands of the real program: what they do, and what they say when something is wrong.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../support/bundle.rs"]
mod bundle;
mod calibrate;
#[path = "../support/clicked.rs"]
mod clicked;
mod estimate;
mod evaluate;
mod objects;
#[path = "../support/onnx.rs"]
mod onnx;
mod refusals;
mod settings;
mod shipped;
mod still;
mod stream;
#[path = "../support/mod.rs"]
mod support;
mod views;

const SCENE: &str = "tests/data/scene";
