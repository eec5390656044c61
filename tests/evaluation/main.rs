//! Scores of poses: against the BOP toolkit, against themselves, and against simulated errors.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod consistency;
mod errors;
mod objects;
mod toolkit;
mod truth;
