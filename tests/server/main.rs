//! The real server, with the shipped models and real clients.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod admin;
mod forms;
mod grpc;
mod http;
mod load;
mod recalibration;
mod stream;
#[path = "../support/mod.rs"]
mod support;
