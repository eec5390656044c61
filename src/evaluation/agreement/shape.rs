use nalgebra::{Rotation3, Unit, Vector3};

use super::error::AgreementError;
use posed_core::geometry::{Pose, Symmetries};

/// What must be known of an object to compare its poses.
#[derive(Clone, Debug)]
pub struct Shape {
    diameter_m: f64,
    object_from_centred: Pose,
    symmetries: Symmetries,
}

impl Shape {
    /// `centre_m` is a point in the middle of the object, in its own frame: translations are compared there, so that it does not
    /// matter where the frame's origin lies. Of a symmetric object it is moved to where no symmetry moves it.
    ///
    /// # Errors
    /// When the diameter is not positive, or a value is not finite.
    pub fn new(diameter_m: f64, centre_m: Vector3<f64>, symmetries: Symmetries) -> Result<Self, AgreementError> {
        if !(diameter_m.is_finite() && diameter_m > 0.0 && centre_m.iter().all(|v| v.is_finite())) {
            return Err(AgreementError::Shape);
        }
        let on_axis = symmetries.continuous().iter().fold(centre_m, |centre, symmetry| {
            symmetry.offset_m + *symmetry.axis * symmetry.axis.dot(&(centre - symmetry.offset_m))
        });
        let equals = symmetries.discrete().iter().map(|symmetry| symmetry.transform(&on_axis));
        let fixed = equals.sum::<Vector3<f64>>() / symmetries.discrete().len() as f64;
        Ok(Self { diameter_m, object_from_centred: Pose::new(Rotation3::identity(), fixed), symmetries })
    }

    /// Largest distance between two points of the object, metres.
    #[must_use]
    pub fn diameter_m(&self) -> f64 {
        self.diameter_m
    }

    /// The frame of the object with its origin moved to the middle.
    pub(super) fn centred(&self, world_from_object: &Pose) -> Pose {
        *world_from_object * self.object_from_centred
    }

    /// The inverse of [`Self::centred`].
    pub(super) fn with_origin(&self, world_from_centred: &Pose) -> Pose {
        *world_from_centred * self.object_from_centred.inverse()
    }

    /// Of all centred poses that look the same, the one turned least from another. Its origin stays where it is.
    pub(super) fn nearest(&self, world_from_centred: &Pose, like: &Pose) -> Pose {
        if self.symmetries.is_trivial() {
            return *world_from_centred;
        }
        self.centred(&self.symmetries.nearest(&self.with_origin(world_from_centred), &self.with_origin(like)))
    }

    /// The axis of revolution in the world, if the object has one: a turn about it cannot be seen.
    pub(super) fn axis(&self, world_from_centred: &Pose) -> Option<Unit<Vector3<f64>>> {
        self.symmetries.continuous().first().map(|symmetry| world_from_centred.rotation() * symmetry.axis)
    }
}
