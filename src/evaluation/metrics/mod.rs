//! Accuracy of poses, of their covariances, of the trust in them and of detections. Pure functions.

mod bootstrap;
mod consistency;
mod detection;
mod hierarchy;
mod least_maximum;
mod model_points;
mod pose_error;
mod recall;
mod statistics;
mod trust;

pub use bootstrap::{Bootstrap, Interval};
pub use consistency::{Consistency, Coverage, GroupConsistency, Nees, PoseNees};
pub use detection::{DetectionScore, FoundBox, Matching, TrueBox};
pub use model_points::{ModelPoints, ModelPointsError};
pub use pose_error::Deviation;
pub use recall::{DegreesCentimetres, Recall, ScoredView};
pub use trust::{Claim, ReliabilityBin, RiskPoint, Trust};
