//! How far two image points are from being views of one 3D point.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::pose::Pose;
use super::rotation::skew;

/// The signed epipolar error `n2ᵀ [t]x R n1` of two points on the plane z = 1 (paper, section 3.2): zero for views of
/// one point. It has the unit of the baseline and depends on where in the image the points lie; see
/// [`sampson_distance`].
#[must_use]
pub fn epipolar_error(second_from_first: &Pose, first: &Vector2<f64>, second: &Vector2<f64>) -> f64 {
    second.push(1.0).dot(&(essential(second_from_first) * first.push(1.0)))
}

/// First-order distance of two points on the plane z = 1 from a pair that satisfies the epipolar constraint (Sampson;
/// Hartley and Zisserman, "Multiple View Geometry", equation 11.9). Times the focal length it is in pixels.
/// Not finite when the cameras do not differ in place.
#[must_use]
pub fn sampson_distance(second_from_first: &Pose, first: &Vector2<f64>, second: &Vector2<f64>) -> f64 {
    let essential = essential(second_from_first);
    let line_in_second: Vector3<f64> = essential * first.push(1.0);
    let line_in_first: Vector3<f64> = essential.transpose() * second.push(1.0);
    let error = second.push(1.0).dot(&line_in_second);
    error.abs() / (line_in_second.xy().norm_squared() + line_in_first.xy().norm_squared()).sqrt()
}

fn essential(second_from_first: &Pose) -> Matrix3<f64> {
    skew(second_from_first.translation()) * second_from_first.rotation().matrix()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn views_of_one_point_have_no_error_and_a_shift_has_its_size(
            point in (-0.3..0.3f64, -0.3..0.3f64, 0.5..2.0f64),
            rotation in prop::array::uniform3(-0.3..0.3f64),
            translation in (-0.3..0.3f64, 0.05..0.1f64, -0.05..0.05f64),
        ) {
            let second_from_first = Pose::new(
                Rotation3::new(rotation.into()),
                Vector3::new(translation.0, translation.1, translation.2),
            );
            let point = Vector3::new(point.0, point.1, point.2);
            let seen = second_from_first.transform(&point);
            prop_assume!(seen.z > 0.1);
            let (first, second) = (point.xy() / point.z, seen.xy() / seen.z);
            prop_assert!(epipolar_error(&second_from_first, &first, &second).abs() < 1e-12);
            // A shift across the epipolar line is split between the two points, so that each moves 1 / sqrt 2 of it
            // where both lines are alike; never more than the whole shift.
            let line = essential(&second_from_first) * first.push(1.0);
            let across = line.xy().normalize() * 1e-4;
            let distance = sampson_distance(&second_from_first, &first, &(second + across));
            prop_assert!(distance > 0.0 && distance <= 1.001e-4, "{distance}");
        }
    }
}
