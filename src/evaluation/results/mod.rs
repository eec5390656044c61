//! Estimates in files that others read: the formats of the BOP benchmark (Hodaň et al., ECCVW 2020).

mod coco;
mod csv;
mod error;
mod name;

pub use coco::{BoxResult, write_boxes};
pub use csv::{PoseResult, read_poses, write_poses};
pub use error::ResultsError;
pub use name::results_name;
