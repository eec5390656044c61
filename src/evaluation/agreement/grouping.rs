//! Which poses are of the same instance: several objects of one class may stand in a scene.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::grid::Grid;
use super::observation::Sighting;
use posed_core::geometry::sigmas;

/// Poses whose middles are within this share of a diameter may be of one instance ...
const NEAR: f64 = 0.5;
/// ... or within so many standard deviations, ...
const NEAR_SIGMAS: f64 = 3.0;
/// ... but never beyond this share.
const FAR: f64 = 1.0;
/// The middle of a group settles in two or three rounds.
const MAX_ROUNDS: usize = 8;

/// The poses of one instance, at most one of each image, by their places in the list.
#[derive(Default)]
pub(super) struct Group {
    pub(super) trusted: Vec<usize>,
    /// Rejected poses: they are compared with the others, which know nothing of them.
    pub(super) rejected: Vec<usize>,
}

/// Groups poses by where they are; how they are turned plays no part, so that a flipped pose stays with its instance. The list must
/// be in the order of trust.
///
/// Each group grows from the most trusted pose that is left: the nearest pose of each image, about a middle that moves to the
/// median. Groups that are within a diameter and never seen in one image are one instance: a pose far off is wrong, not another
/// object. The work is proportional to the number of poses, and of instances within a diameter.
pub(super) fn groups(sightings: &[Sighting], diameter_m: f64) -> Vec<Group> {
    let mut grid = Grid::new(FAR * diameter_m);
    let trusted = |index: &usize| sightings[*index].observation.is_trusted();
    for index in (0..sightings.len()).filter(trusted) {
        grid.insert(sightings[index].pose.translation(), index);
    }
    let mut taken = vec![false; sightings.len()];
    let mut found = Vec::new();
    for seed in (0..sightings.len()).filter(trusted) {
        // A pose on the border of a group may be left over by it.
        while !taken[seed] {
            let (middle, members) = grow(sightings, &grid, seed, diameter_m);
            for index in &members {
                taken[*index] = true;
            }
            grid.retain_near(&middle, |index| !taken[index]);
            found.push(members);
        }
    }
    let mut groups = joined(sightings, found, diameter_m);
    attach_rejected(sightings, &mut groups, diameter_m);
    groups
}

/// The group about a pose: never empty.
fn grow(sightings: &[Sighting], grid: &Grid, seed: usize, diameter_m: f64) -> (Vector3<f64>, Vec<usize>) {
    let mut middle = *sightings[seed].pose.translation();
    let mut members = vec![seed];
    for _ in 0..MAX_ROUNDS {
        let mut of_image = BTreeMap::<u32, (f64, usize)>::new();
        for index in grid.near(&middle) {
            let distance = (sightings[index].pose.translation() - middle).norm();
            if distance <= reach(&sightings[index], diameter_m) {
                let best = of_image.entry(sightings[index].observation.image_id).or_insert((distance, index));
                if (distance, index) < *best {
                    *best = (distance, index);
                }
            }
        }
        let nearest: Vec<_> = of_image.into_values().map(|(_, index)| index).collect();
        if nearest.is_empty() || nearest == members {
            break;
        }
        members = nearest;
        middle = median(sightings, &members);
    }
    (middle, members)
}

fn reach(sighting: &Sighting, diameter_m: f64) -> f64 {
    (NEAR_SIGMAS * sigmas(&sighting.covariance).0).clamp(NEAR * diameter_m, FAR * diameter_m)
}

/// The median of each coordinate.
fn median(sightings: &[Sighting], members: &[usize]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| {
        let mut values: Vec<_> = members.iter().map(|index| sightings[*index].pose.translation()[axis]).collect();
        values.sort_by(f64::total_cmp);
        let half = values.len() / 2;
        if values.len() % 2 == 1 { values[half] } else { f64::midpoint(values[half - 1], values[half]) }
    })
}

/// Groups after those that are one instance were joined, the largest first.
fn joined(sightings: &[Sighting], mut found: Vec<Vec<usize>>, diameter_m: f64) -> Vec<Group> {
    // Stable: of equally large ones that with the most trusted pose stays first.
    found.sort_by_key(|members| std::cmp::Reverse(members.len()));
    let mut grid = Grid::new(FAR * diameter_m);
    let mut kept: Vec<(Vector3<f64>, BTreeSet<u32>, Group)> = Vec::new();
    for members in found {
        let middle = median(sightings, &members);
        let images: BTreeSet<_> = members.iter().map(|index| sightings[*index].observation.image_id).collect();
        let fits = |place: &usize| {
            let (other, seen, _) = &kept[*place];
            (middle - other).norm() <= FAR * diameter_m && images.is_disjoint(seen)
        };
        let distance = |place: &usize| (middle - kept[*place].0).norm();
        let host = grid.near(&middle).filter(fits).min_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
        if let Some(host) = host {
            let (_, seen, group) = &mut kept[host];
            seen.extend(images);
            group.trusted.extend(members);
        } else {
            grid.insert(&middle, kept.len());
            kept.push((middle, images, Group { trusted: members, rejected: Vec::new() }));
        }
    }
    kept.into_iter().map(|(_, _, group)| group).collect()
}

/// Puts each rejected pose to the nearest group that has none of its image; what is near none becomes a group of its own.
fn attach_rejected(sightings: &[Sighting], groups: &mut Vec<Group>, diameter_m: f64) {
    let mut grid = Grid::new(FAR * diameter_m);
    let image = |index: &usize| sightings[*index].observation.image_id;
    let mut seen = Vec::new();
    for (place, group) in groups.iter().enumerate() {
        let middle = median(sightings, &group.trusted);
        grid.insert(&middle, place);
        seen.push((middle, group.trusted.iter().map(image).collect::<BTreeSet<_>>()));
    }
    for (index, sighting) in sightings.iter().enumerate().filter(|(_, one)| !one.observation.is_trusted()) {
        let distance = |place: usize| (sighting.pose.translation() - seen[place].0).norm();
        let fits = |place: &usize| distance(*place) <= FAR * diameter_m && !seen[*place].1.contains(&image(&index));
        let host = grid.near(sighting.pose.translation()).filter(fits);
        if let Some(host) = host.min_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(a.cmp(b))) {
            seen[host].1.insert(image(&index));
            groups[host].rejected.push(index);
        } else {
            groups.push(Group { trusted: Vec::new(), rejected: vec![index] });
        }
    }
}
