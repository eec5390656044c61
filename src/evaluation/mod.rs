//! BOP datasets: ground truth in, accuracy out.

mod bop;
mod mesh;
mod metrics;

pub use bop::{BopError, GroundTruth, image_ids, read_image, scenes};
pub use mesh::{MeshError, ObjectMesh};
pub use metrics::{Deviation, Score, add};
