//! Which sightings in several views are of one object, where several of a kind stand about.

use nalgebra::{Matrix3, Unit, Vector3};

use super::assignment::assign;
use crate::geometry::{Pose, Symmetries};

/// How well the direction to an object is known, as a share of its radius: boxes and keypoints of a half-hidden object lie off
/// its middle.
const SIDEWAYS: f64 = 0.3;
/// How well its distance is, as a share of the distance: less than a single view states, since here nothing may be missed.
const DEPTH: f64 = 0.06;
/// 99.9 % of chi-squared with 3 degrees of freedom: sightings further apart are of two objects.
const GATE: f64 = 16.27;
/// What a difference of orientations costs at most. Less than the gate: a view may see an object flipped.
const MAX_TURN_COST: f64 = 8.0;
/// The turn that costs 1.
const TURN_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// What sightings that cannot be of one object cost more than they could gain.
const APART: f64 = 3.0 * GATE;
const MAX_SWEEPS: usize = 20;

/// One object in one view.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// The view that it is in; a view shows each object once.
    pub view: usize,
    /// The object's pose as that view alone has it.
    pub world_from_points: Pose,
    /// Where the camera stood in the world.
    pub camera_in_world: Vector3<f64>,
    /// Standard deviation of the camera's place, metres, its rotation taken along.
    pub camera_sigma_m: f64,
}

/// Groups sightings of one kind of object: each group is one instance, with at most one sighting of each view, in the order of
/// the sightings. Sightings are paired where their rays pass each other nearby and at about the distances that each view
/// sees (epipolar gating), preferably with one orientation; among all groupings the total cost decides, not who comes first.
///
/// `centre_m` is the middle of the points in their frame, `radius_m` how far they lie from it.
#[must_use]
pub fn associate(
    sightings: &[Sighting],
    centre_m: &Vector3<f64>,
    radius_m: f64,
    symmetries: &Symmetries,
) -> Vec<Vec<usize>> {
    let places: Vec<Place> = sightings.iter().map(|sighting| Place::of(sighting, centre_m, radius_m)).collect();
    let gain = |a: usize, b: usize| {
        let apart = places[a].squared_to(&places[b]);
        if apart > GATE {
            return GATE - apart.min(APART);
        }
        let (pose, like) = (sightings[a].world_from_points, sightings[b].world_from_points);
        let turn = symmetries.nearest(&pose, &like).angle_to(&like) / TURN_RAD;
        GATE - apart - (turn * turn).min(MAX_TURN_COST)
    };
    let count = sightings.len();
    let mut gains = vec![0.0; count * count];
    for a in 0..count {
        for b in 0..a {
            if sightings[a].view != sightings[b].view {
                let gain = gain(a, b);
                (gains[a * count + b], gains[b * count + a]) = (gain, gain);
            }
        }
    }
    group(sightings, &gains)
}

/// Where an object is, as one view has it.
struct Place {
    at: Vector3<f64>,
    covariance: Matrix3<f64>,
}

impl Place {
    fn of(sighting: &Sighting, centre_m: &Vector3<f64>, radius_m: f64) -> Self {
        let at = sighting.world_from_points.transform(centre_m);
        let arm = at - sighting.camera_in_world;
        let ray = Unit::new_normalize(arm);
        let sideways = (SIDEWAYS * radius_m).powi(2) + sighting.camera_sigma_m.powi(2);
        let depth = (DEPTH * arm.norm()).powi(2);
        Self { at, covariance: Matrix3::identity() * sideways + *ray * ray.transpose() * depth }
    }

    fn squared_to(&self, other: &Self) -> f64 {
        let apart = other.at - self.at;
        (self.covariance + other.covariance).cholesky().map_or(f64::INFINITY, |factor| apart.dot(&factor.solve(&apart)))
    }
}

/// Takes the sightings of one view after another to where they gain most, all of a view at once, until none moves.
fn group(sightings: &[Sighting], gains: &[f64]) -> Vec<Vec<usize>> {
    let count = sightings.len();
    let views: Vec<usize> = {
        let mut views: Vec<_> = sightings.iter().map(|sighting| sighting.view).collect();
        views.sort_unstable();
        views.dedup();
        views
    };
    // Each is alone to begin with.
    let mut groups: Vec<Vec<usize>> = (0..count).map(|index| vec![index]).collect();
    for _ in 0..MAX_SWEEPS {
        let mut moved = false;
        for view in &views {
            let own: Vec<usize> = (0..count).filter(|index| sightings[*index].view == *view).collect();
            let before = groups.clone();
            for group in &mut groups {
                group.retain(|index| !own.contains(index));
            }
            groups.retain(|group| !group.is_empty());
            let joined = assign(own.len(), groups.len(), |row, column| {
                -groups[column].iter().map(|other| gains[own[row] * count + other]).sum::<f64>()
            });
            for (index, group) in own.iter().zip(joined) {
                match group {
                    Some(group) => groups[group].push(*index),
                    None => groups.push(vec![*index]),
                }
            }
            for group in &mut groups {
                group.sort_unstable();
            }
            groups.sort_unstable();
            moved |= groups != before;
        }
        if !moved {
            break;
        }
    }
    groups
}
