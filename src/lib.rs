//! 6D poses of known rigid objects from one RGB image.
//!
//! The map of the house, bottom up; each part uses only those above it:
//!
//! - [`posed_core`], a crate of its own: geometry, cameras, PnP, calibration. Frames and units are stated there.
//! - [`vision`]: decoding, resampling, drawing.
//! - [`model`]: model folders, references and the runtime of the networks.
//! - [`estimator`]: image in, poses out; the queue in front of it.
//! - [`evaluation`]: BOP datasets.
//! - [`proto`]: the gRPC messages.
//! - [`server`]: HTTP and gRPC.
//! - [`commands`]: the sub-commands of the program.
#![forbid(unsafe_code)]

pub mod commands;
pub mod estimator;
pub mod evaluation;
pub mod model;
pub mod proto;
pub mod server;
pub mod vision;

pub use posed_core::{calibration, geometry, pnp};
