//! From an image to poses, and the bounded queue in front of it. Knows nothing of HTTP or gRPC.

mod answer;
mod calibrate;
mod detect;
mod gates;
mod job;
mod keypoints;
mod parity;
mod picture;
mod pipeline;
mod queue;
mod verdict;
mod workers;

pub use answer::{
    Abandoned, CallerFrames, Detection, Estimate, EstimateError, KeypointPrediction, MeasureError, ObjectPose,
    Selection, SolvedKeypoint, SolvedPose, Timings,
};
pub use calibrate::{CalibrateError, MeasuredView, calibrate};
pub use job::{Answer, QueueError, ReferenceWork, Solved, Work};
pub use keypoints::KeypointSolver;
pub use parity::{Parity, ParityError};
pub use pipeline::{Estimator, Frame};
pub use queue::{Queue, QueueConfig, QueueStats};
pub use verdict::{Reason, Reasons, Verdict};
pub use workers::StartError;
