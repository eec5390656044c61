//! A still scene whose poses are drawn about the true ones with known covariances.

use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};
use posed::evaluation::agreement::{Bounds, JudgedObservation, Observation, SceneAgreement, Shape};
use posed_core::geometry::{Covariance6, Pose, Symmetries};
use posed_core::pnp::Status;
use rand::SeedableRng as _;
use rand::rngs::SmallRng;
use rand_distr::{Distribution as _, StandardNormal};

pub(crate) const DIAMETER_M: f64 = 0.1;
const DISTANCE_M: f64 = 0.5;

pub(crate) fn shape() -> Shape {
    Shape::new(DIAMETER_M, Vector3::zeros(), Symmetries::default()).unwrap()
}

pub(crate) fn truth() -> Pose {
    Pose::new(Rotation3::new(Vector3::new(0.3, -0.8, 1.1)), Vector3::new(0.2, -0.1, 0.05))
}

/// Cameras all around, looking at an object.
pub(crate) fn camera(index: usize, views: usize, target: &Pose) -> Vector3<f64> {
    let angle = std::f64::consts::TAU * index as f64 / views as f64;
    target.translation() + Vector3::new(angle.cos(), angle.sin(), 0.8).normalize() * DISTANCE_M
}

/// Of a view: 4 mm along the ray, 1 mm across, one degree; the turn and the place are correlated.
fn covariance(camera: &Vector3<f64>, target: &Pose) -> Covariance6 {
    let ray = (target.translation() - camera).normalize();
    let along = ray * ray.transpose();
    let translation = along * 0.004_f64.powi(2) + (Matrix3::identity() - along) * 0.001_f64.powi(2);
    let mut covariance = Matrix6::identity() * 1_f64.to_radians().powi(2);
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&translation);
    let mut mixed = Matrix6::identity();
    mixed.fixed_view_mut::<3, 3>(0, 3).copy_from(&(Matrix3::new(0.1, 0.5, 0.0, -0.2, 0.0, 0.3, 0.4, 0.0, 0.2) * 0.05));
    mixed * covariance * mixed.transpose()
}

/// What `views` images show of an object, image ids from 0.
pub(crate) fn drawn(target: &Pose, views: usize, seed: u64) -> Vec<Observation> {
    let mut rng = SmallRng::seed_from_u64(seed);
    let view = |index: usize| {
        let camera_in_world = camera(index, views, target);
        let covariance = covariance(&camera_in_world, target);
        let normals = Vector6::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let step: Vector6<f64> = covariance.cholesky().unwrap().l() * normals;
        let world_from_object =
            target.perturbed(&step.fixed_rows::<3>(0).into_owned(), &step.fixed_rows::<3>(3).into_owned());
        let (image_id, status) = (u32::try_from(index).unwrap(), Status::Ok);
        Observation { image_id, world_from_object, covariance, camera_in_world, status, confidence: 0.9 }
    };
    (0..views).map(view).collect()
}

pub(crate) fn agreement(shape: &Shape, observations: Vec<Observation>) -> SceneAgreement {
    SceneAgreement::of("table".into(), shape, &Bounds::default(), observations).unwrap()
}

/// The poses of the only instance, in the order of their images.
pub(crate) fn judged(shape: &Shape, observations: Vec<Observation>) -> Vec<JudgedObservation> {
    let scene = agreement(shape, observations);
    assert_eq!((scene.instances.len(), scene.alone.len()), (1, 0));
    scene.instances.into_iter().next().unwrap().observations
}
