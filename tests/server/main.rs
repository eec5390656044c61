//! The real server, with the shipped models and real clients.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod access;
mod admin;
mod boxes;
mod connections;
mod counting;
mod deadlines;
mod forms;
mod grpc;
mod hostile;
mod http;
mod hung;
mod lifecycle;
mod load;
mod models;
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
