use nalgebra::{Matrix2, Matrix6, Vector2};
use thiserror::Error;

use crate::geometry::{Camera, Covariance6, Pose, excess};
use crate::pnp::{PnpError, Solution};

/// What one camera saw of the object.
#[derive(Clone, Debug)]
pub struct View<'a> {
    /// The camera of the pixels.
    pub camera: &'a Camera,
    /// Where it stood.
    pub world_from_camera: Pose,
    /// Covariance of a step of `world_from_camera` along the axes of the world; [`ViewsOptions::camera_covariance`] where there is
    /// none.
    ///
    /// [`ViewsOptions::camera_covariance`]: super::ViewsOptions::camera_covariance
    pub camera_covariance: Option<Covariance6>,
    /// Where it saw the points: at least one reading. Without modes the first counts.
    pub readings: &'a [Reading],
    /// The poses that explain this view alone, best first. Without any, the view has no say in where refinement starts.
    pub modes: &'a [Mode],
    /// What its word counts against that of others where they contradict each other, above 0.
    pub trust: f64,
}

/// Where a view shows the points. One that leaves two answers open, as a network does that sees two peaks of each point, has a
/// reading for each.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// Of the points, in their order.
    pub pixels: Vec<Vector2<f64>>,
    /// How well they are known, px².
    pub covariances_px: Vec<Matrix2<f64>>,
}

/// A pose that explains one view.
#[derive(Clone, Copy, Debug)]
pub struct Mode {
    /// Where the points are.
    pub camera_from_points: Pose,
    /// Place of the reading that it explains, among its view's.
    pub reading: usize,
    /// Of a step along the camera's axes.
    pub covariance: Covariance6,
    /// The part of it that the errors of all points have in common: the view may see the pose off by such a step, and no number of
    /// points averages it out. Zero where their errors are independent.
    pub shared: Covariance6,
    /// Posterior weight among the view's modes, 0..1.
    pub weight: f64,
}

impl Mode {
    /// The pose of a solution and its alternatives, of the first reading, as if the errors of its points were independent.
    #[must_use]
    pub fn all_of(solution: &Solution) -> Vec<Self> {
        let Solution { pose, covariance, weight, alternatives, .. } = solution;
        let shared = Matrix6::zeros();
        let first = Self { camera_from_points: *pose, reading: 0, covariance: *covariance, shared, weight: *weight };
        let others = alternatives.iter().flatten().map(|other| Self {
            camera_from_points: other.pose,
            reading: 0,
            covariance: other.covariance,
            shared,
            weight: other.weight,
        });
        std::iter::once(first).chain(others).collect()
    }

    /// The same mode where its covariance is known better than its points say. What is larger than they say is what their errors
    /// have in common.
    #[must_use]
    pub fn with_covariance(self, known: &Covariance6) -> Self {
        Self { covariance: *known, shared: excess(known, &self.covariance), ..self }
    }
}

/// Views that no pose can be solved from.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ViewsError {
    #[error("view {view}: {source}")]
    View { view: usize, source: PnpError },
    #[error("view {view}: the pose or the covariance of its camera has a value that is not finite")]
    NotFinite { view: usize },
    #[error("view {view}: the covariance of its camera's pose is not symmetric, or has a negative eigenvalue")]
    CameraCovariance { view: usize },
    #[error("view {view}: a pose of it explains reading {reading}, and it has {readings} readings")]
    NoReading { view: usize, reading: usize, readings: usize },
    #[error("no view has a pose to start from")]
    NoModes,
    #[error("no pose puts the points in front of the cameras and near their pixels")]
    NoPose,
}

/// The covariance of a step whose translation (metres) and rotation (radians) have these standard deviations along each
/// axis.
#[must_use]
pub fn isotropic_covariance(translation_m: f64, rotation_rad: f64) -> Covariance6 {
    let (translation, rotation) = (translation_m * translation_m, rotation_rad * rotation_rad);
    Matrix6::from_diagonal(&[translation, translation, translation, rotation, rotation, rotation].into())
}
