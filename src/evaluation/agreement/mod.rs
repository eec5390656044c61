//! How exact poses are, told without ground truth: of a still scene, photographed from known camera poses, every image must give
//! the same `world_from_object`. How far each pose is from what the others say is its error, as far as the others are right.
//!
//! What this cannot see is an error that all images share: that of the calibrated offset, or a shift of all camera poses. Images
//! from nearly one direction share more, such as a wrong depth; so the angle between the views is reported, too. From all around, a
//! wrong scale (of the keypoints, the focal length or the camera poses) shows as a depth that most views err in alike.
//! Errors of single camera poses count as errors of the answers.
//!
//! The offset's uncertainty is part of an answer's covariance, but all answers share that one error. [`Observation`]s come without
//! it. Of a symmetric object the answers do not quite share it: it is turned by the symmetry that they differ by.

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
