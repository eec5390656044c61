//! Behaviour of the PnP solver through its public interface, on seeded problems and on problems known to be hard.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod exact;
mod hard;
mod outliers;
mod scene;
mod statistics;
mod unusable;
