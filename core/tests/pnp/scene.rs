//! Random problems. Each has its own seed, so that no problem depends on another.

use nalgebra::{Matrix2, Rotation2, Rotation3, Vector2, Vector3};
use posed_core::geometry::{Camera, Pose};
use posed_core::pnp::{Options, Solution, solve};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, StandardNormal};

/// A camera, an object of 0.1 to 0.2 m at 0.5 to 1 m, and the generator of everything random about them.
pub(crate) struct Scene {
    pub rng: SmallRng,
    pub camera: Camera,
    pub pose: Pose,
}

/// The pixels of a problem and what is known of their errors.
pub(crate) struct Seen {
    pub pixels: Vec<Vector2<f64>>,
    pub covariances: Vec<Matrix2<f64>>,
}

impl Scene {
    pub(crate) fn new(test: u64, problem: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(test << 32 | problem);
        // Uniform over rotations: a normalised quaternion of normal numbers.
        let quaternion =
            nalgebra::Quaternion::from_vector(nalgebra::Vector4::from_fn(|_, _| StandardNormal.sample(&mut rng)));
        let rotation = nalgebra::UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
        let [x, y] = [rng.random_range(-0.15..0.15), rng.random_range(-0.1..0.1)];
        let pose = Pose::new(rotation, Vector3::new(x, y, rng.random_range(0.5..1.0)));
        Self { rng, camera: Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap(), pose }
    }

    /// The same object, turned as before, this much further away.
    pub(crate) fn further(mut self, factor: f64) -> Self {
        self.pose = Pose::new(*self.pose.rotation(), self.pose.translation() * factor);
        self
    }

    pub(crate) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal()).normalize()
    }

    pub(crate) fn points_in_shell(&mut self, count: usize) -> Vec<Vector3<f64>> {
        (0..count).map(|_| self.direction() * self.rng.random_range(0.05..0.1)).collect()
    }

    pub(crate) fn project(&self, points: &[Vector3<f64>]) -> Vec<Vector2<f64>> {
        points.iter().map(|point| self.camera.project(&self.pose.transform(point)).unwrap()).collect()
    }

    /// Pixels with the same error, in pixels, in every direction.
    pub(crate) fn see(&mut self, points: &[Vector3<f64>], sigma: f64) -> Seen {
        let pixels =
            self.project(points).iter().map(|p| p + Vector2::new(self.normal(), self.normal()) * sigma).collect();
        Seen { pixels, covariances: vec![Matrix2::identity() * (sigma * sigma); points.len()] }
    }

    /// Pixels with errors of 0.5 to 8 px, up to four times as long as wide, every one different.
    pub(crate) fn see_unequally(&mut self, points: &[Vector3<f64>]) -> Seen {
        let mut seen = Seen { pixels: self.project(points), covariances: Vec::new() };
        for pixel in &mut seen.pixels {
            let long = 0.5 * 16.0_f64.powf(self.rng.random_range(0.0..1.0));
            let short = (long / self.rng.random_range(1.0..4.0)).max(0.5);
            let turn = Rotation2::new(self.rng.random_range(0.0..3.2));
            let root = turn.matrix() * Matrix2::from_diagonal(&Vector2::new(long, short));
            *pixel += root * Vector2::new(self.normal(), self.normal());
            seen.covariances.push(root * root.transpose());
        }
        seen
    }

    /// `count` different indices below `below`.
    pub(crate) fn choose(&mut self, count: usize, below: usize) -> Vec<usize> {
        rand::seq::index::sample(&mut self.rng, below, count).into_vec()
    }

    pub(crate) fn solve(&self, points: &[Vector3<f64>], seen: &Seen) -> Solution {
        solve(points, &seen.pixels, &seen.covariances, &self.camera, &exact()).unwrap()
    }

    pub(crate) fn error_deg(&self, pose: &Pose) -> f64 {
        pose.angle_to(&self.pose).to_degrees()
    }
}

/// The default keypoints: corners of a cube in a sphere of this radius.
pub(crate) fn cube(radius: f64) -> Vec<Vector3<f64>> {
    let side = radius / 3.0_f64.sqrt();
    (0..8).map(|k| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { side } else { -side })).collect()
}

/// No floor: tests state the noise exactly.
pub(crate) fn exact() -> Options {
    Options { floor_px: 0.0, ..Options::default() }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

pub(crate) fn turned(axis: [f64; 3], degrees: f64, translation: [f64; 3]) -> Pose {
    let axis = nalgebra::Unit::new_normalize(Vector3::from(axis));
    Pose::new(Rotation3::from_axis_angle(&axis, degrees.to_radians()), translation.into())
}
