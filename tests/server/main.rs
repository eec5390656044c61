//! The real server, with the shipped models and real clients.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod access;
mod admin;
mod boxes;
#[path = "../support/bundle.rs"]
mod bundle;
mod bundles;
#[path = "../support/clicked.rs"]
mod clicked;
mod connections;
mod counting;
mod deadlines;
mod forms;
mod grpc;
mod hostile;
mod hot_add;
mod http;
mod hung;
mod lifecycle;
mod load;
mod models;
mod objects;
#[path = "../support/onnx.rs"]
mod onnx;
mod raw;
mod raw_grpc;
mod recalibration;
mod rollout;
mod stream;
#[path = "../support/mod.rs"]
mod support;
mod track;
mod upload;
mod views;
