//! From an image to poses, and the bounded queue in front of it. Knows nothing of HTTP or gRPC.

mod pipeline;
mod queue;
mod report;

pub use pipeline::{
    Detection, Estimate, EstimateError, Estimator, KeypointPrediction, ObjectPose, SolvedPose, Timings, solve_object,
};
pub use queue::{Answer, Job, Queue, QueueError, Work};
pub use report::{PoseReport, Report};
