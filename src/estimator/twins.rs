//! Poses of one thing that was boxed twice: detectors put a loose box about a tight one.

use nalgebra::Vector3;

use super::answer::{ObjectPose, SolvedPose};
use crate::model::Library;
use posed_core::geometry::{Pose, Symmetries};
use posed_core::pnp::Status;

/// Least share of the smaller box that lies in the larger one. Of a stack of things, the lower ones stick out.
const MIN_SHARED: f64 = 0.7;
/// How far two poses of one thing lie apart across the line of sight, in diameters. Things side by side are farther from
/// each other than this, unless they are thinner.
const MAX_LATERAL: f64 = 0.04;
/// ... and along it, where boxes of different size mislead a network most.
const MAX_DEPTH: f64 = 0.35;
/// ... if both are `ok`: of two that differ by more, one is wrong, which is better seen than hidden.
const MAX_DEPTH_OF_OK: f64 = 0.1;
const MAX_TURN_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// Of the poses of one thing leaves the first, with the box that its detector was surer of; or the one of a track, since its
/// tracker measures by that. Boxes that the caller gave have an answer each.
pub(super) fn leave_out_twins(poses: &mut Vec<ObjectPose>, library: &Library) {
    let mut kept: Vec<ObjectPose> = Vec::with_capacity(poses.len());
    for pose in poses.drain(..) {
        let twin = kept.iter().position(|first| are_one(first, &pose, library));
        let Some(first) = twin.map(|at| &mut kept[at]) else {
            kept.push(pose);
            continue;
        };
        match (first.track, pose.track) {
            (None, None) if pose.detection.score > first.detection.score => first.detection = pose.detection,
            (_, None) => {}
            (None, Some(_)) if pose.verdict.status == first.verdict.status => *first = pose,
            // Tracks are told apart by their tracker.
            (_, Some(_)) => kept.push(pose),
        }
    }
    *poses = kept;
}

fn are_one(one: &ObjectPose, other: &ObjectPose, library: &Library) -> bool {
    let [first, second] = [one, other].map(|pose| pose.detection);
    let may_be = first.object == second.object
        && first.given.is_none()
        && second.given.is_none()
        && first.bounding_box.shared(&second.bounding_box) > MIN_SHARED;
    let model = library.objects.get(first.object).and_then(Option::as_ref).filter(|_| may_be);
    model.zip(one.pose.as_ref().zip(other.pose.as_ref())).is_some_and(|(model, (a, b))| {
        let both_ok = [one, other].iter().all(|pose| pose.verdict.status == Status::Ok);
        let max_depth = if both_ok { MAX_DEPTH_OF_OK } else { MAX_DEPTH };
        let apart = centre(b) - centre(a);
        let depth = apart.dot(&centre(a).normalize());
        let lateral = (apart.norm_squared() - depth * depth).max(0.0).sqrt();
        lateral < MAX_LATERAL * one.diameter_m
            && depth.abs() < max_depth * one.diameter_m
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
