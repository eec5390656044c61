//! The real server, with the shipped models and real clients.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod admin;
mod forms;
mod grpc;
mod hostile;
mod http;
mod load;
mod models;
mod raw;
mod recalibration;
mod stream;
#[path = "../support/mod.rs"]
mod support;
mod upload;
