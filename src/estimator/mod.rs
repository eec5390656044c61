//! From an image to poses, and the bounded queue in front of it. Knows nothing of HTTP or gRPC.

mod admission;
mod answer;
mod calibrate;
mod candidate;
mod cores;
mod detect;
mod doubts;
mod ensemble;
mod evidence;
mod expected;
mod feed;
mod follow;
mod footprint;
mod frame;
mod gates;
mod given;
mod hint;
mod hints;
mod job;
mod keypoints;
mod look;
mod mistakes;
mod objects;
mod pace;
mod parity;
mod picture;
mod pipeline;
mod prepare;
mod queue;
mod reading;
mod rows;
mod second_peaks;
mod solver;
mod stated_pose;
mod stats;
mod twins;
mod update;
mod verdict;
mod views;
mod watchdog;
mod worker;

pub use admission::{Admission, BodyLease, PixelLease, Place, Refusal, Room};
pub use answer::{
    Abandoned, CallerFrames, Detection, Estimate, EstimateError, GivenBox, KeypointPrediction, MeasureError,
    ObjectPose, Observed, Selection, SolvedKeypoint, SolvedPose, Spread, Timings,
};
pub use calibrate::{
    CalibrateError, CalibrateOptions, Calibrated, KeypointsScale, MeasuredView, average_offsets, calibrate,
    measure_offset,
};
pub use candidate::{CandidateError, load_candidate};
pub use detect::MAX_DETECTIONS;
pub use doubts::fit_to_measure;
pub use expected::{Expected, Guide};
pub use follow::{FollowOptions, Follower, Tracked};
pub use frame::Frame;
pub use hint::Hint;
pub use job::{Answer, Located, QueueError, ReferenceWork, Work};
pub use parity::{Parity, ParityError};
pub use pipeline::Estimator;
pub use queue::{Queue, QueueConfig};
pub use solver::KeypointSolver;
pub use stated_pose::{StatedPoseError, no_view_twice};
pub use stats::Stats;
pub use update::{Update, UpdateError};
pub use verdict::{Reason, Reasons, Verdict};
pub use views::{
    CamerasError, FusedPose, LeftOut, LocatedView, PosedCamera, ViewShare, ViewsPicture, cameras_are_meant,
    fit_offset_and_scale, fuse,
};
pub use worker::StartError;
