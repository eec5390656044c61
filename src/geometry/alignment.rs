use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use super::Pose;
use super::pose::nearest_rotation;

/// Point sets that no rigid transform can be fitted to.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AlignmentError {
    #[error("{from} points to be aligned with {to}; the counts must be equal and at least 3")]
    Count { from: usize, to: usize },
    #[error("point pair {index} has a value that is not finite")]
    NotFinite { index: usize },
    #[error("the points lie on one line or in one place; their rotation about it is not determined")]
    Degenerate,
}

/// Second largest singular value over the largest below which points count as lying on a line.
const MIN_SPREAD: f64 = 1e-9;

/// The rigid transform `to_from_from` (a proper rotation, no scale) with the least sum of squared distances between
/// `to` and the moved `from`: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
///
/// # Errors
/// [`AlignmentError`] names what is wrong with the points.
pub fn align(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Result<Pose, AlignmentError> {
    if from.len() != to.len() || from.len() < 3 {
        return Err(AlignmentError::Count { from: from.len(), to: to.len() });
    }
    if let Some(index) = from.iter().zip(to).position(|(a, b)| !a.iter().chain(b).all(|v| v.is_finite())) {
        return Err(AlignmentError::NotFinite { index });
    }
    let (from_centre, to_centre) = (mean(from), mean(to));
    let correlation: Matrix3<f64> =
        from.iter().zip(to).map(|(a, b)| (b - to_centre) * (a - from_centre).transpose()).sum();
    let singular = correlation.singular_values();
    if singular[1] <= MIN_SPREAD * singular[0] {
        return Err(AlignmentError::Degenerate);
    }
    let rotation = nearest_rotation(&correlation);
    Ok(Pose::new(rotation, to_centre - rotation * from_centre))
}

fn mean(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::tests::any_pose;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Vector3<f64>>> {
        prop::collection::vec(prop::array::uniform3(-1.0..1.0f64).prop_map(Vector3::from), 4..12)
    }

    fn squared_error(pose: &Pose, from: &[Vector3<f64>], to: &[Vector3<f64>]) -> f64 {
        from.iter().zip(to).map(|(a, b)| (pose.transform(a) - b).norm_squared()).sum()
    }

    proptest! {
        #[test]
        fn recovers_the_motion(pose in any_pose(), from in points(), flatten in any::<bool>()) {
            // Points of a plane too: a reflection would fit them as well.
            let from: Vec<_> = from.iter().map(|p| if flatten { Vector3::new(p.x, p.y, 0.0) } else { *p }).collect();
            let to: Vec<_> = from.iter().map(|p| pose.transform(p)).collect();
            let found = align(&from, &to).unwrap();
            prop_assert!((found.matrix() - pose.matrix()).norm() < 1e-6);
        }

        #[test]
        fn no_motion_nearby_fits_better(
            from in points(), noise in prop::array::uniform3(-0.3..0.3f64), step in prop::array::uniform6(-0.01..0.01f64),
        ) {
            let to: Vec<_> = from.iter().enumerate().map(|(k, p)| p + Vector3::from(noise) * ((k % 3) as f64 - 1.0)).collect();
            let best = align(&from, &to).unwrap();
            let [x, y, z, a, b, c] = step;
            let other = best.perturbed(&Vector3::new(x, y, z), &Vector3::new(a, b, c));
            prop_assert!(squared_error(&best, &from, &to) <= squared_error(&other, &from, &to) + 1e-12);
        }
    }

    #[test]
    fn unusable_points_are_named() {
        let line: Vec<_> = (0..5).map(|k| Vector3::new(f64::from(k), 0.0, 0.0)).collect();
        assert_eq!(align(&line, &line), Err(AlignmentError::Degenerate));
        assert_eq!(align(&[Vector3::zeros(); 4], &[Vector3::zeros(); 4]), Err(AlignmentError::Degenerate));
        assert_eq!(align(&line[..2], &line[..2]), Err(AlignmentError::Count { from: 2, to: 2 }));
        assert_eq!(align(&line, &line[..4]), Err(AlignmentError::Count { from: 5, to: 4 }));
        let mut broken = line.clone();
        broken[3].y = f64::NAN;
        assert_eq!(align(&line, &broken), Err(AlignmentError::NotFinite { index: 3 }));
    }
}
