use std::cmp::Ordering;

use nalgebra::{Matrix6, Unit, Vector3};

use super::error::AgreementError;
use super::shape::Shape;
use posed_core::geometry::{Covariance6, Pose, covariance_about};
use posed_core::pnp::Status;

/// One pose of an object, found in one image of a still scene.
#[derive(Clone, Debug)]
pub struct Observation {
    pub image_id: u32,
    pub world_from_object: Pose,
    /// Of `world_from_object`, along the world's axes, without what all images share: the uncertainty of the offset.
    pub covariance: Covariance6,
    /// Where the camera stood, frame `world`, metres.
    pub camera_in_world: Vector3<f64>,
    pub status: Status,
    /// 0..1.
    pub confidence: f64,
}

/// An observation that was checked, about the middle of the object.
#[derive(Clone, Debug)]
pub(super) struct Sighting {
    pub(super) observation: Observation,
    /// `world_from_object`, its origin moved to the object's middle.
    pub(super) pose: Pose,
    pub(super) covariance: Covariance6,
    /// Inverse of the covariance.
    pub(super) information: Matrix6<f64>,
    /// Direction from the camera to the object's middle.
    pub(super) ray: Unit<Vector3<f64>>,
}

impl Observation {
    pub(super) fn checked(self, shape: &Shape) -> Result<Sighting, AgreementError> {
        let image_id = self.image_id;
        let numbers = self.world_from_object.matrix();
        let numbers = numbers.iter().chain(&self.covariance).chain(&self.camera_in_world).chain([&self.confidence]);
        if !numbers.copied().all(f64::is_finite) {
            return Err(AgreementError::NotFinite { image_id });
        }
        let pose = shape.centred(&self.world_from_object);
        let lever = pose.translation() - self.world_from_object.translation();
        let covariance = covariance_about(&self.covariance, &lever);
        let factor = covariance.cholesky().ok_or(AgreementError::Covariance { image_id })?;
        let ray = Unit::try_new(pose.translation() - self.camera_in_world, f64::EPSILON);
        let ray = ray.ok_or(AgreementError::CameraInObject { image_id })?;
        Ok(Sighting { pose, covariance, information: factor.inverse(), ray, observation: self })
    }

    /// The most trusted first; an order in which only equal observations are equal.
    pub(super) fn order(&self, other: &Self) -> Ordering {
        let numbers = |one: &Self| one.world_from_object.matrix();
        self.status
            .cmp(&other.status)
            .then(other.confidence.total_cmp(&self.confidence))
            .then(self.image_id.cmp(&other.image_id))
            .then_with(|| {
                numbers(self).iter().zip(&numbers(other)).fold(Ordering::Equal, |o, (a, b)| o.then(a.total_cmp(b)))
            })
    }

    pub(super) fn is_trusted(&self) -> bool {
        self.status != Status::Rejected
    }
}
