//! Poses from several views through the public interface, on seeded scenes.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod association;
mod contradictions;
mod exact;
mod readings;
mod scale;
mod scene;
mod statistics;
mod symmetric;
mod unusable;
