//! Datasets of the field: ground truth in, accuracy out. And of a still scene without ground truth, how far its views agree.

pub mod agreement;
mod dataset;
mod mesh;
mod metrics;
mod models_info;
mod ply;

pub use dataset::{
    Annotation, DatasetError, GroundTruth, ImageError, ImageProblem, ReadOptions, Scene, SceneFolder, Target, Targets,
    View, scenes,
};
pub use mesh::{MeshError, ObjectMesh};
pub use metrics::{Deviation, Score, add};
