//! Datasets of the field: ground truth in, accuracy out.

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
pub use metrics::{
    Bootstrap, Claim, Consistency, Coverage, DegreesCentimetres, DetectionScore, Deviation, FoundBox, GroupConsistency,
    Interval, Matching, ModelPoints, ModelPointsError, Nees, PoseNees, Recall, ReliabilityBin, RiskPoint, ScoredView,
    TrueBox, Trust,
};
