//! Random scenes: one object, cameras around it. Each has its own seed.

use nalgebra::{Matrix2, Matrix3, Matrix6, Rotation3, Vector2, Vector3, Vector6};
use posed_core::geometry::{Camera, Covariance6, Pose, Symmetries};
use posed_core::pnp::{self, Solution};
use posed_core::views::{
    Mode, Reading, View, ViewsError, ViewsOptions, ViewsSolution, isotropic_covariance, solve_views,
};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};

pub(crate) struct Scene {
    pub rng: SmallRng,
    pub camera: Camera,
    pub world_from_points: Pose,
    pub points: Vec<Vector3<f64>>,
}

/// What one camera saw.
#[derive(Clone)]
pub(crate) struct Seen {
    pub world_from_camera: Pose,
    pub camera_covariance: Covariance6,
    pub readings: Vec<Reading>,
    pub modes: Vec<Mode>,
}

impl Scene {
    pub(crate) fn new(test: u64, problem: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(0x71E5 << 48 | test << 32 | problem);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let turn = Vector3::from_fn(|_, _| normal()) * 2.0;
        let place = Vector3::from_fn(|_, _| normal()) * 0.5;
        let points = (0..14).map(|_| Vector3::from_fn(|_, _| normal()).normalize() * 0.06).collect();
        let world_from_points = Pose::new(Rotation3::new(turn), place);
        Self { rng, camera: Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap(), world_from_points, points }
    }

    pub(crate) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// A camera that looks at about the object, from half a metre to a metre, from a random side.
    pub(crate) fn around(&mut self) -> Pose {
        let direction = Vector3::from_fn(|_, _| self.normal());
        self.seen_from(&direction)
    }

    pub(crate) fn seen_from(&mut self, direction: &Vector3<f64>) -> Pose {
        let distance = self.rng.random_range(0.5..0.9);
        let shift = Vector3::from_fn(|_, _| self.normal()) * 0.03;
        let aim = self.world_from_points.translation() + shift;
        let forward = -direction.normalize();
        let roll = Vector3::from_fn(|_, _| self.normal());
        let right = forward.cross(&roll).normalize();
        let rotation = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
        Pose::new(Rotation3::from_matrix_unchecked(rotation), aim - forward * distance)
    }

    /// The object at another pose, seen with an error of `sigma` pixels from where a camera stands; `stated` is where it is
    /// said to stand.
    pub(crate) fn see_at(&mut self, pose: &Pose, camera: &Pose, stated: &Pose, sigma: f64) -> Seen {
        let camera_from_points = camera.inverse() * *pose;
        let points = self.points.clone();
        let pixel = |point: &Vector3<f64>| {
            let error = Vector2::new(self.normal(), self.normal()) * sigma;
            self.camera.project(&camera_from_points.transform(point)).unwrap() + error
        };
        let pixels: Vec<_> = points.iter().map(pixel).collect();
        let covariances = vec![Matrix2::identity() * (sigma * sigma).max(1e-4); points.len()];
        let modes = Mode::all_of(&self.solve_alone(&pixels, &covariances));
        let readings = vec![Reading { pixels, covariances_px: covariances }];
        Seen { world_from_camera: *stated, camera_covariance: Matrix6::zeros(), readings, modes }
    }

    pub(crate) fn see(&mut self, camera: &Pose, sigma: f64) -> Seen {
        let pose = self.world_from_points;
        self.see_at(&pose, camera, camera, sigma)
    }

    pub(crate) fn solve_alone(&self, pixels: &[Vector2<f64>], covariances: &[Matrix2<f64>]) -> Solution {
        let options = pnp::Options { floor_px: 0.0, ..pnp::Options::default() };
        pnp::solve(&self.points, pixels, covariances, &self.camera, &options).unwrap()
    }

    /// The only reading.
    pub(crate) fn solve_reading(&self, seen: &Seen) -> Vec<Mode> {
        let Reading { pixels, covariances_px } = &seen.readings[0];
        Mode::all_of(&self.solve_alone(pixels, covariances_px))
    }

    pub(crate) fn view<'a>(&'a self, seen: &'a Seen) -> View<'a> {
        View {
            camera: &self.camera,
            world_from_camera: seen.world_from_camera,
            camera_covariance: Some(seen.camera_covariance),
            readings: &seen.readings,
            modes: &seen.modes,
            trust: 1.0,
        }
    }

    pub(crate) fn solve(&self, seen: &[Seen]) -> ViewsSolution {
        self.solve_symmetric(seen, &Symmetries::default()).unwrap()
    }

    pub(crate) fn solve_symmetric(&self, seen: &[Seen], symmetries: &Symmetries) -> Result<ViewsSolution, ViewsError> {
        let views: Vec<_> = seen.iter().map(|seen| self.view(seen)).collect();
        solve_views(&self.points, &views, symmetries, &exact())
    }

    /// A random step with this covariance, which must be diagonal.
    pub(crate) fn step(&mut self, covariance: &Covariance6) -> (Vector3<f64>, Vector3<f64>) {
        let step: Vector6<f64> = covariance.diagonal().map(|variance| variance.sqrt() * self.normal());
        (step.fixed_rows::<3>(0).into(), step.fixed_rows::<3>(3).into())
    }

    /// Largest distance of a point between two poses, metres.
    pub(crate) fn error_m(&self, pose: &Pose) -> f64 {
        let errors = self.points.iter().map(|p| (pose.transform(p) - self.world_from_points.transform(p)).norm());
        errors.fold(0.0, f64::max)
    }
}

/// No floor, exact cameras: tests state the errors exactly.
pub(crate) fn exact() -> ViewsOptions {
    ViewsOptions { floor_px: 0.0, camera_covariance: isotropic_covariance(0.0, 0.0), tempering: 1.0 }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Squared Mahalanobis distance of a pose error: 6 on average where the covariance is true.
pub(crate) fn nees(truth: &Pose, pose: &Pose, covariance: &Covariance6) -> f64 {
    let error = pose.step_to(truth);
    error.dot(&(covariance.cholesky().unwrap().inverse() * error))
}
