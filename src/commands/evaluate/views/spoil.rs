//! Views that are wrong on purpose.

use fastrand::Rng;
use nalgebra::{Rotation3, Unit, Vector3};

use crate::estimator::{Estimate, SolvedPose};
use crate::model::ObjectModel;
use posed_core::geometry::Pose;

/// An object that is turned by less from one that looks the same is hardly turned.
const LEAST_TURN_RAD: f64 = std::f64::consts::FRAC_PI_3;
const MAX_DRAWS: usize = 100;

/// Lets a view see an object turned by half a turn about a random axis through its middle, with the errors that its keypoints have.
/// False where the view does not see the object.
pub(super) fn flip(estimate: &mut Estimate, class: usize, model: &ObjectModel, random: &mut Rng) -> bool {
    let first = estimate.poses.iter().filter(|found| found.detection.object == class).find_map(|found| {
        let solved = found.pose.as_ref()?;
        Some((solved.camera_from_object, solved.observed.modes.first()?.camera_from_points))
    });
    let Some((camera_from_object, camera_from_keypoints)) = first else { return false };
    let keypoints_from_object = camera_from_keypoints.inverse() * camera_from_object;
    let mut drawn = || {
        let axis = Vector3::from_fn(|_, _| random.f64() - 0.5);
        let half_turn = Rotation3::from_axis_angle(&Unit::new_normalize(axis), std::f64::consts::PI);
        let flip = Pose::new(half_turn, Vector3::zeros());
        let turned = camera_from_keypoints * flip * keypoints_from_object;
        (flip, model.symmetries.nearest(&turned, &camera_from_object).angle_to(&camera_from_object))
    };
    // Of a symmetric object many a half turn is hardly one.
    let first = drawn();
    let widest = |best: (Pose, f64), other: (Pose, f64)| if best.1 < LEAST_TURN_RAD { other } else { best };
    let (flip, _) = (0..MAX_DRAWS).fold(first, |best, _| widest(best, drawn()));
    let camera = estimate.camera.clone();
    let mut flipped = false;
    for found in estimate.poses.iter_mut().filter(|found| found.detection.object == class) {
        let Some(solved) = &mut found.pose else { continue };
        let SolvedPose { observed, camera_from_object, keypoints_scale, .. } = solved;
        let Some(first) = observed.modes.first().map(|mode| mode.camera_from_points) else { continue };
        let points = model.manifest.keypoints_scaled_by(*keypoints_scale);
        for (place, reading) in observed.readings.iter_mut().enumerate() {
            let explaining = observed.modes.iter().find(|mode| mode.reading == place);
            let Some(seen) = explaining.map(|mode| mode.camera_from_points) else { continue };
            for (point, pixel) in points.iter().zip(&mut reading.pixels) {
                let from = camera.project(&seen.transform(point));
                let to = camera.project(&(seen * flip).transform(point));
                if let (Ok(from), Ok(to)) = (from, to) {
                    *pixel += to - from;
                }
            }
        }
        for mode in &mut observed.modes {
            mode.camera_from_points = mode.camera_from_points * flip;
        }
        let object_from_keypoints = camera_from_object.inverse() * first;
        *camera_from_object = first * flip * object_from_keypoints.inverse();
        flipped = true;
    }
    flipped
}
