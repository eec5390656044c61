//! Datasets of the field: ground truth in, accuracy out. And of a still scene without ground truth, how far its views agree.

mod across;
pub mod agreement;
mod assign;
mod dataset;
mod html;
mod mesh;
mod metrics;
mod models_info;
mod ply;
mod record;
mod report;
mod results;
mod stream;
mod visibility;

pub use assign::assign;
pub use dataset::{
    Annotation, DatasetError, GroundTruth, ImageError, ImageProblem, ReadOptions, Scene, SceneFolder, Target, Targets,
    View, scenes,
};
pub use html::{Outline, Picture, ReferencesCurve, Sheet, Spread, close_up, page, references_plot};
pub use mesh::{MeshError, ObjectMesh};
pub use metrics::{
    Bootstrap, Claim, Consistency, Coverage, DegreesCentimetres, DetectionScore, Deviation, FoundBox, GroupConsistency,
    Interval, Matching, ModelPoints, ModelPointsError, Nees, PoseNees, Recall, ReliabilityBin, RiskPoint, ScoredView,
    TrueBox, Trust,
};
pub use record::{Answer, DetectedBox, Place, Record, Scored, Unmatched};
pub use report::{
    Boxes, Counted, Detections, FalseLine, Intervals, ObjectRecords, Picks, Report, Section, Verdicts, ViewLine, picks,
};
pub use results::{BoxResult, PoseResult, ResultsError, read_poses, results_name, write_boxes, write_poses};
pub use stream::{Followed, Instant, StreamScore};
pub use visibility::VisibleRange;
