//! Poses of one thing that was boxed twice, as detectors do with a tight and a loose box.

use nalgebra::Vector3;

use super::answer::{ObjectPose, SolvedPose};
use crate::model::Library;
use posed_core::geometry::{Pose, Symmetries};

/// How far two poses of one thing lie apart across the line of sight, in diameters. Things side by side are farther from
/// each other than this, unless they are thinner.
const MAX_LATERAL: f64 = 0.04;
/// ... and along it, where boxes of different size mislead a network most. What lies behind its like is hidden by it.
const MAX_DEPTH: f64 = 0.35;
const MAX_TURN_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// Of the poses of one thing leaves the first. If another one was tracked, the first takes its track: who follows the thing
/// would lose it. Boxes that the caller gave have an answer each.
pub(super) fn leave_out_twins(poses: &mut Vec<ObjectPose>, library: &Library) {
    let mut kept: Vec<ObjectPose> = Vec::with_capacity(poses.len());
    for pose in poses.drain(..) {
        match kept.iter_mut().find(|first| are_one(first, &pose, library)) {
            Some(first) => first.track = first.track.or(pose.track),
            None => kept.push(pose),
        }
    }
    *poses = kept;
}

fn are_one(one: &ObjectPose, other: &ObjectPose, library: &Library) -> bool {
    let [first, second] = [one, other].map(|pose| pose.detection);
    let may_be = first.object == second.object && first.given.is_none() && second.given.is_none();
    let model = library.objects.get(first.object).and_then(Option::as_ref).filter(|_| may_be);
    model.zip(one.pose.as_ref().zip(other.pose.as_ref())).is_some_and(|(model, (a, b))| {
        let apart = centre(b) - centre(a);
        let depth = apart.dot(&centre(a).normalize());
        let lateral = (apart.norm_squared() - depth * depth).max(0.0).sqrt();
        lateral < MAX_LATERAL * one.diameter_m
            && depth.abs() < MAX_DEPTH * one.diameter_m
            && turn(&model.symmetries, &a.camera_from_object, &b.camera_from_object) < MAX_TURN_RAD
    })
}

/// In the camera's frame, metres.
fn centre(solved: &SolvedPose) -> Vector3<f64> {
    solved.box_in_camera.iter().sum::<Vector3<f64>>() / solved.box_in_camera.len() as f64
}

/// The angle between two poses of a symmetric object, at least.
fn turn(symmetries: &Symmetries, a: &Pose, b: &Pose) -> f64 {
    symmetries.nearest(b, a).angle_to(a)
}
