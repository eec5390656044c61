//! How exact poses are, told without ground truth: of a still scene, photographed from known camera poses, every image must give
//! the same `world_from_object`. How far each pose is from what the others say is its error, as far as the others are right.
//!
//! What this cannot see is an error that all images share: that of the calibrated offset, or of camera poses that are wrong
//! as a whole. It is also blind to errors that images from nearly one direction share, such as that of the depth. So the
//! angle between the views is reported, too.

mod consensus;
mod deviation;
mod error;
mod grid;
mod grouping;
mod observation;
mod scene;
mod shape;
mod totals;
mod warnings;

pub use deviation::{Bounds, Nees, ViewDeviation};
pub use error::AgreementError;
pub use observation::Observation;
pub use scene::{Found, Instance, JudgedObservation, SceneAgreement};
pub use shape::Shape;
pub use totals::{Quantiles, Spread, Totals};
pub use warnings::{BLIND_SPOTS, warnings};
