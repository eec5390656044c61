//! BOP datasets: ground truth in.

mod bop;

pub use bop::{BopError, GroundTruth, read_image};
