use nalgebra::{Unit, Vector3};

/// Two directions that are perpendicular to one, and to each other.
pub(super) fn across(direction: &Unit<Vector3<f64>>) -> [Vector3<f64>; 2] {
    let other = Vector3::ith(direction.iamin(), 1.0);
    let first = direction.cross(&other).normalize();
    [first, direction.cross(&first)]
}
