//! 6D poses of known rigid objects from one RGB image.
//!
//! The map of the house, bottom up; each part uses only those above it:
//!
//! - [`geometry`]: rigid transforms, cameras, image affines. Conventions of frames and units are stated there.
//! - [`pnp`]: pose from keypoints, with covariance, alternatives and a status.
//! - [`calibration`]: the offset between an object's virtual keypoints and its user's frame.
//! - [`vision`]: decoding, resampling, drawing.
//! - [`model`]: model folders, references and the runtime of the networks.
//! - [`estimator`]: image in, poses out; the queue in front of it.
//! - [`evaluation`]: BOP datasets.
//! - [`proto`]: the gRPC messages.
//! - [`server`]: HTTP and gRPC.
//! - [`commands`]: the sub-commands of the program.
#![forbid(unsafe_code)]

pub mod calibration;
pub mod commands;
pub mod estimator;
pub mod evaluation;
pub mod geometry;
pub mod model;
pub mod pnp;
pub mod proto;
pub mod server;
pub mod vision;
