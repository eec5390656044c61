//! Poses over time: what single images say of rigid objects becomes tracks with ids, velocities and covariances.
//!
//! 1. Each track has an error-state Kalman filter on SE(3) for each of two motions: it stands still, or it moves with a
//!    velocity that changes at random ([`Options`] states how much). The two are an interacting multiple model (Blom and
//!    Bar-Shalom, 1988): a still object is averaged over many frames, and one that starts to move is followed at once.
//! 2. Measurements are matched with tracks of their object, the nearest pair first, by the Mahalanobis distance of the
//!    nearest of all poses that look alike, or that the solver could not exclude. One beyond the gate is a jump: the
//!    other symmetric answer of a network, another instance. It is told, and not taken until it has come several times.
//! 3. A track without a measurement coasts, and is lost after a while. A measurement where a lost one was last seen is
//!    that one again.
//!
//! The frame `world` is one in which the caller knows the cameras; it is the camera's own where nothing is known.

mod filter;
mod options;
mod state;
mod track;
mod tracker;

pub use options::{Options, OptionsError};
pub use track::{Shape, TrackState, TrackView};
pub use tracker::{MAX_TRACKS, Measurement, Prediction, TimeError, Tracker};
