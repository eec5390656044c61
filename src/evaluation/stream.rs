//! How well the tracks of a stream follow what is there, beside the poses of its single images.

use nalgebra::{Vector3, Vector6};
use serde::Serialize;

use super::metrics::{Consistency, ModelPoints, PoseNees};
use posed_core::geometry::{Covariance6, Pose};

/// A right pose has an ADD(-S) below this, of the diameter.
const RIGHT: f64 = 0.1;

/// One instance in one image.
#[derive(Clone, Debug)]
pub struct Instant {
    /// Of the object in the frame of the stream's world, as the poses below.
    pub truth: Pose,
    /// What the tracks say.
    pub followed: Option<Followed>,
    /// What the image alone says.
    pub single: Option<Pose>,
}

/// A track that is at an instance.
#[derive(Clone, Debug)]
pub struct Followed {
    pub id: u64,
    pub pose: Pose,
    pub covariance: Covariance6,
}

/// Of all instances of one object in one scene.
#[derive(Clone, Debug, Serialize)]
pub struct StreamScore {
    /// Instances, each counted in each image.
    pub instants: usize,
    /// Share of them that a track is at, 0..1.
    pub followed: f64,
    /// How often another track is at an instance than before.
    pub identity_switches: usize,
    pub tracks: Errors,
    pub single: Errors,
    pub consistency: Consistency,
}

/// How far poses are from the truth, and from each other.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Errors {
    /// Share with an ADD(-S) below a tenth of the diameter, of all instants.
    pub right: f64,
    /// Medians.
    pub translation_m: f64,
    pub rotation_deg: f64,
    /// Median distance of the errors from their own median: how much a pose strays that should rest.
    pub spread_m: f64,
    pub spread_deg: f64,
    /// Median change of the error from one image to the next.
    pub step_m: f64,
}

impl StreamScore {
    /// From the instants of each instance, in the order of the images. `None` without any.
    #[must_use]
    pub fn of(points: &ModelPoints, instances: &[Vec<Instant>]) -> Option<Self> {
        let all = || instances.iter().flatten();
        let instants = Some(all().count()).filter(|count| *count > 0)?;
        let nees = |one: &Instant| {
            let followed = one.followed.as_ref()?;
            Some(PoseNees::new(points, &followed.pose, &followed.covariance, &one.truth))
        };
        let nees: Vec<Option<PoseNees>> = all().filter_map(nees).collect();
        let errors = |pose: fn(&Instant) -> Option<Pose>| Errors::of(points, instances, pose);
        Some(Self {
            instants,
            followed: nees.len() as f64 / instants as f64,
            identity_switches: instances.iter().map(|instants| switches(instants)).sum(),
            tracks: errors(|one| one.followed.as_ref().map(|followed| followed.pose)),
            single: errors(|one| one.single),
            consistency: Consistency::of(&nees),
        })
    }
}

fn switches(instants: &[Instant]) -> usize {
    let ids: Vec<u64> = instants.iter().filter_map(|one| one.followed.as_ref().map(|followed| followed.id)).collect();
    ids.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

impl Errors {
    fn of(points: &ModelPoints, instances: &[Vec<Instant>], pose: fn(&Instant) -> Option<Pose>) -> Self {
        let limit_m = RIGHT * points.diameter_m();
        let (mut right, mut count) = (0, 0);
        let (mut sizes, mut strays, mut steps) = (Vec::new(), Vec::new(), Vec::new());
        for instants in instances {
            count += instants.len();
            let error = |one: &Instant| {
                let estimate = pose(one)?;
                let distance_m = points.average_distance_m(&estimate, &one.truth);
                let nearest = points.symmetries().nearest(&estimate, &one.truth);
                Some((one.truth.step_to(&nearest), distance_m < limit_m))
            };
            let errors: Vec<(Vector6<f64>, bool)> = instants.iter().filter_map(error).collect();
            right += errors.iter().filter(|(_, right)| *right).count();
            let errors: Vec<Vector6<f64>> = errors.into_iter().map(|(error, _)| error).collect();
            let middle = Vector6::from_fn(|axis, _| median(errors.iter().map(|error| error[axis]).collect()));
            sizes.extend(errors.iter().copied());
            strays.extend(errors.iter().map(|error| error - middle));
            steps.extend(errors.windows(2).map(|pair| pair[1] - pair[0]));
        }
        let translation = |all: &[Vector6<f64>]| median(all.iter().map(|one| part(one, 0)).collect());
        let rotation_deg = |all: &[Vector6<f64>]| median(all.iter().map(|one| part(one, 3)).collect()).to_degrees();
        Self {
            right: f64::from(u32::try_from(right).unwrap_or(u32::MAX)) / count.max(1) as f64,
            translation_m: translation(&sizes),
            rotation_deg: rotation_deg(&sizes),
            spread_m: translation(&strays),
            spread_deg: rotation_deg(&strays),
            step_m: translation(&steps),
        }
    }
}

fn part(step: &Vector6<f64>, first: usize) -> f64 {
    let part: Vector3<f64> = step.fixed_rows::<3>(first).into();
    part.norm()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
