//! Views in one form: points about their centre, poses in the world.

use nalgebra::{Matrix6, Rotation3, Vector3, Vector6};

use super::options::ViewsOptions;
use super::view::{Mode, Reading, View, ViewsError};
use crate::geometry::{
    Covariance6, Pose, Symmetries, block_diagonal, covariance_about, is_covariance, join, rotated_covariance,
};
use crate::pnp::Problem;

/// What is known of the object: its points about their centre.
pub(super) struct Body<'a> {
    pub points: Vec<Vector3<f64>>,
    /// Root mean square distance of the points from their centre.
    pub radius_m: f64,
    symmetries: &'a Symmetries,
    points_from_centred: Pose,
}

/// A view in the world.
pub(super) struct Prepared {
    /// One for each reading.
    pub problems: Vec<Problem>,
    pub world_from_camera: Pose,
    pub camera_from_world: Pose,
    /// Turns a step along the world's axes to the camera's.
    pub camera_from_world_axes: Matrix6<f64>,
    pub camera_covariance: Covariance6,
    pub modes: Vec<Placed>,
    pub trust: f64,
}

/// A mode in the world, about the points' centre.
#[derive(Clone, Copy)]
pub(super) struct Placed {
    pub world_from_centred: Pose,
    pub reading: usize,
    pub covariance: Covariance6,
    /// The part of it that the view's points have in common.
    pub shared: Covariance6,
    pub weight: f64,
}

impl Placed {
    /// The same mode as a pose that looks the same.
    pub(super) fn meaning(&self, equal: &Pose) -> Self {
        let lever = equal.translation() - self.world_from_centred.translation();
        let about = |covariance| covariance_about(covariance, &lever);
        let (covariance, shared) = (about(&self.covariance), about(&self.shared));
        Self { world_from_centred: *equal, covariance, shared, ..*self }
    }
}

impl<'a> Body<'a> {
    pub(super) fn new(points: &[Vector3<f64>], symmetries: &'a Symmetries) -> Self {
        let share = (points.len().max(1) as f64).recip();
        let centre = points.iter().sum::<Vector3<f64>>() * share;
        let centred: Vec<_> = points.iter().map(|point| point - centre).collect();
        let radius_m = (centred.iter().map(Vector3::norm_squared).sum::<f64>() * share).sqrt();
        let points_from_centred = Pose::new(Rotation3::identity(), centre);
        Self { points: centred, radius_m, symmetries, points_from_centred }
    }

    /// Of all poses that look like one, that turned least from another.
    pub(super) fn nearest(&self, pose: &Pose, like: &Pose) -> Pose {
        if self.symmetries.is_trivial() {
            return *pose;
        }
        let (pose, like) = (self.with_origin(pose), self.with_origin(like));
        self.symmetries.nearest(&pose, &like) * self.points_from_centred
    }

    /// The pose of the frame that the points were given in.
    pub(super) fn with_origin(&self, world_from_centred: &Pose) -> Pose {
        *world_from_centred * self.points_from_centred.inverse()
    }

    /// What a turn about the axis of revolution moves, if there is one: a unit step, of a pose in the world.
    pub(super) fn turn(&self, world_from_centred: &Pose) -> Option<Vector6<f64>> {
        let symmetry = self.symmetries.continuous().first()?;
        let axis = world_from_centred.rotation() * *symmetry.axis;
        let on_axis = self.with_origin(world_from_centred).transform(&symmetry.offset_m);
        let centre = world_from_centred.translation();
        Some(join(&axis.cross(&(centre - on_axis)), &axis))
    }
}

impl Prepared {
    pub(super) fn new(
        index: usize,
        view: &View<'_>,
        body: &Body<'_>,
        options: &ViewsOptions,
    ) -> Result<Self, ViewsError> {
        let camera_covariance = view.camera_covariance.unwrap_or(options.camera_covariance);
        let pose = view.world_from_camera.matrix();
        if !(pose.iter().chain(&camera_covariance).all(|v| v.is_finite()) && view.trust.is_finite()) {
            return Err(ViewsError::NotFinite { view: index });
        }
        if !is_covariance(&camera_covariance) {
            return Err(ViewsError::CameraCovariance { view: index });
        }
        let readings = view.readings.len();
        let missing = view.modes.iter().map(|mode| mode.reading).chain([0]).find(|reading| *reading >= readings);
        if let Some(reading) = missing {
            return Err(ViewsError::NoReading { view: index, reading, readings });
        }
        let problem = |reading: &Reading| {
            let Reading { pixels, covariances_px } = reading;
            let problem = Problem::new(&body.points, pixels, covariances_px, view.camera, options.floor_px);
            problem.map_err(|source| ViewsError::View { view: index, source })
        };
        let problems = view.readings.iter().map(problem).collect::<Result<_, _>>()?;
        let world_from_camera = view.world_from_camera;
        let camera_from_world = world_from_camera.inverse();
        let placed = |mode: &Mode| {
            let camera_from_centred = mode.camera_from_points * body.points_from_centred;
            let lever = camera_from_centred.translation() - mode.camera_from_points.translation();
            let in_world =
                |covariance| rotated_covariance(world_from_camera.rotation(), &covariance_about(covariance, &lever));
            Placed {
                world_from_centred: world_from_camera * camera_from_centred,
                reading: mode.reading,
                covariance: in_world(&mode.covariance),
                shared: in_world(&mode.shared),
                weight: mode.weight.max(f64::MIN_POSITIVE),
            }
        };
        Ok(Self {
            problems,
            world_from_camera,
            camera_from_world,
            camera_from_world_axes: block_diagonal(camera_from_world.rotation().matrix()),
            camera_covariance,
            modes: view.modes.iter().map(placed).collect(),
            trust: view.trust,
        })
    }

    /// How far off this view sees an object for its camera's pose alone: moving a camera is moving what it sees the other way.
    pub(super) fn by_camera(&self, world_from_centred: &Pose) -> Covariance6 {
        let lever = world_from_centred.translation() - self.world_from_camera.translation();
        covariance_about(&self.camera_covariance, &lever)
    }

    /// Direction from the camera to the object.
    pub(super) fn ray(&self, world_from_centred: &Pose) -> Vector3<f64> {
        (world_from_centred.translation() - self.world_from_camera.translation()).normalize()
    }

    /// Median distance of the points from where a pose puts them, as a share of how far the points spread in this view;
    /// infinite behind the camera.
    pub(super) fn misfit(&self, reading: usize, world_from_centred: &Pose) -> f64 {
        let camera_from_centred = self.camera_from_world * *world_from_centred;
        let seen = self.problems[reading].observations();
        let mut distances = Vec::with_capacity(seen.len());
        let mut spread = 0.0;
        let centre = camera_from_centred.translation();
        if centre.z <= 0.0 {
            return f64::INFINITY;
        }
        for point in seen {
            let at = camera_from_centred.transform(&point.point);
            if at.z <= 0.0 {
                return f64::INFINITY;
            }
            let projected = at.xy() / at.z;
            distances.push((projected - point.image).norm());
            spread += (projected - centre.xy() / centre.z).norm_squared();
        }
        distances.sort_by(f64::total_cmp);
        distances[distances.len() / 2] / (spread / seen.len() as f64).sqrt()
    }

    /// What the camera's pose may add to [`Prepared::misfit`].
    pub(super) fn misfit_by_camera(&self, world_from_centred: &Pose, radius_m: f64) -> f64 {
        let by_camera = self.by_camera(world_from_centred);
        by_camera.fixed_view::<3, 3>(0, 0).trace().sqrt() / radius_m
    }
}
