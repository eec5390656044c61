//! The offset itself: measured on one image, applied to a pose.

use crate::geometry::{
    Covariance6, Pose, Symmetries, block_diagonal, covariance_about, rotated_covariance, sigmas, skew,
};

/// `object_from_keypoints` with its covariance along the axes of the frame `object`.
#[derive(Clone, Debug)]
pub struct Offset {
    /// The keypoints' frame in the user's, metres.
    pub object_from_keypoints: Pose,
    /// Of a step along the axes of frame `object`, see [`Pose::perturbed`].
    pub covariance: Covariance6,
    /// What the keypoints' coordinates are multiplied by before a pose is solved from them: 1 unless views from several sides
    /// showed the object to be larger or smaller than the network learned it.
    pub keypoints_scale: f64,
}

impl Offset {
    /// Measures the offset on one image: what the network and PnP say against the known pose, which is taken as exact.
    #[must_use]
    pub fn measure(camera_from_object: &Pose, camera_from_keypoints: &Pose, covariance: &Covariance6) -> Self {
        let object_from_camera = camera_from_object.inverse();
        Self {
            object_from_keypoints: object_from_camera * *camera_from_keypoints,
            // A step along the camera's axes, turned into the object's axes.
            covariance: rotated_covariance(object_from_camera.rotation(), covariance),
            keypoints_scale: 1.0,
        }
    }

    /// The same offset, measured on the one of the object's orientations that look alike which is nearest to another
    /// offset's. A network sees any of them in an image, so the offsets of several images differ by such motions.
    #[must_use]
    pub fn nearest(&self, symmetries: &Symmetries, like: &Self) -> Self {
        // `symmetry * offset` is the inverse of `offset⁻¹ * symmetry⁻¹`, and the group holds every inverse.
        let (own, other) = (self.object_from_keypoints.inverse(), like.object_from_keypoints.inverse());
        let object_from_keypoints = symmetries.nearest(&own, &other).inverse();
        let turn = object_from_keypoints * own;
        Self { object_from_keypoints, covariance: rotated_covariance(turn.rotation(), &self.covariance), ..*self }
    }

    /// The same offset of keypoints that were scaled before they were solved.
    #[must_use]
    pub fn of_keypoints_scaled_by(self, keypoints_scale: f64) -> Self {
        Self { keypoints_scale, ..self }
    }

    /// Standard deviations over all axes: of the translation (metres) and of the rotation (radians).
    #[must_use]
    pub fn sigmas(&self) -> (f64, f64) {
        sigmas(&self.covariance)
    }

    /// `camera_from_object` and its covariance, from a solved pose of the keypoints. The errors of both add up.
    #[must_use]
    pub fn apply(&self, camera_from_keypoints: &Pose, covariance: &Covariance6) -> (Pose, Covariance6) {
        let camera_from_object = *camera_from_keypoints * self.object_from_keypoints.inverse();
        let lever = camera_from_object.translation() - camera_from_keypoints.translation();
        let by_offset = {
            // object_from_keypoints moves by (τ, ψ) along the object's axes: the answer turns by -R ψ, and moves
            // by R (ψ x t - τ), with t the offset's translation.
            let rotation = camera_from_object.rotation().matrix();
            let mut jacobian = -block_diagonal(rotation);
            let swing = -rotation * skew(self.object_from_keypoints.translation());
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&swing);
            jacobian
        };
        let total = covariance_about(covariance, &lever) + by_offset * self.covariance * by_offset.transpose();
        (camera_from_object, total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::parts;
    use nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
    use proptest::prelude::*;

    fn any_pose() -> impl Strategy<Value = Pose> {
        (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-0.5..0.5f64))
            .prop_map(|(r, t)| Pose::new(Rotation3::new(Vector3::from(r)), Vector3::from(t)))
    }

    fn perturbed(pose: &Pose, axis: usize, size: f64) -> Pose {
        let (translation, rotation) = parts(&Vector6::ith(axis, size));
        pose.perturbed(&translation, &rotation)
    }

    const SMALL: f64 = 1e-6;

    /// Propagates by differences what `function` does to a covariance.
    fn numeric(function: impl Fn(&Pose) -> Pose, at: &Pose, covariance: &Covariance6) -> Covariance6 {
        let centre = function(at);
        let mut jacobian = Matrix6::zeros();
        for axis in 0..6 {
            jacobian.set_column(axis, &(centre.step_to(&function(&perturbed(at, axis, SMALL))) / SMALL));
        }
        jacobian * covariance * jacobian.transpose()
    }

    fn some_covariance() -> Covariance6 {
        let root = Matrix6::from_fn(|r, c| ((r * 7 + c * 3) % 5) as f64 * 0.1 + f64::from(u8::from(r == c)));
        root * root.transpose()
    }

    proptest! {
        #[test]
        fn the_offset_gives_back_the_reference_pose(object in any_pose(), keypoints in any_pose()) {
            let offset = Offset::measure(&object, &keypoints, &some_covariance());
            let (pose, _) = offset.apply(&keypoints, &some_covariance());
            prop_assert!((pose.matrix() - object.matrix()).norm() < 1e-9);
        }

        #[test]
        fn covariance_of_a_measured_offset(object in any_pose(), keypoints in any_pose()) {
            let offset = Offset::measure(&object, &keypoints, &some_covariance());
            let expected = numeric(|k| object.inverse() * *k, &keypoints, &some_covariance());
            prop_assert!((offset.covariance - expected).amax() < 1e-3);
        }

        #[test]
        fn covariance_of_an_answer(offset in any_pose(), keypoints in any_pose()) {
            let of_offset = some_covariance() * 0.5;
            let calibrated = Offset { object_from_keypoints: offset, covariance: of_offset, keypoints_scale: 1.0 };
            let (_, covariance) = calibrated.apply(&keypoints, &some_covariance());
            let expected = numeric(|k| *k * offset.inverse(), &keypoints, &some_covariance())
                + numeric(|o| keypoints * o.inverse(), &offset, &of_offset);
            prop_assert!((covariance - expected).amax() < 1e-3, "{covariance} {expected}");
        }
    }
}
