//! Reading datasets through the public interface: small folders of each layout, right ones and wrong ones. And what the poses of
//! a still scene tell without ground truth.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod agreement;
mod bop;
mod cameras;
mod folder;
mod linemod;
mod mesh;
mod real;
mod still_scene;
mod targets;
