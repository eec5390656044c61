//! Reading datasets through the public interface: small folders of each layout, right ones and wrong ones.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod bop;
mod folder;
mod linemod;
mod mesh;
mod real;
mod targets;
