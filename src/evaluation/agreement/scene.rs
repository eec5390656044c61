use serde::{Serialize, Serializer};

use super::consensus::Consensus;
use super::deviation::{Bounds, ViewDeviation};
use super::error::AgreementError;
use super::grouping::{Group, groups};
use super::observation::{Observation, Sighting};
use super::shape::Shape;
use crate::model::PoseFile;
use posed_core::geometry::Pose;
use posed_core::pnp::Status;

/// Looks for the views that span the widest angle; each finds one that is farther off than the last.
const MAX_SWEEPS: usize = 8;

/// A pose that was found in an image.
#[derive(Clone, Debug, Serialize)]
pub struct Found {
    pub image_id: u32,
    pub status: Status,
    pub confidence: f64,
    #[serde(serialize_with = "as_file")]
    pub world_from_object: Pose,
}

/// A pose, and how far it is from what the other views of its instance say.
#[derive(Clone, Debug, Serialize)]
pub struct JudgedObservation {
    #[serde(flatten)]
    pub found: Found,
    /// From the consensus of the others; of a rejected pose, from that of all that are not rejected.
    pub deviation: ViewDeviation,
}

/// One object of a scene, seen in two images or more.
#[derive(Clone, Debug, Serialize)]
pub struct Instance {
    /// What the views agree in.
    #[serde(serialize_with = "as_file")]
    pub world_from_object: Pose,
    /// Number of views that it rests on; where it is 1, no two views agree.
    pub support: usize,
    /// Largest angle between the directions that two images see it from.
    pub view_angle_deg: f64,
    pub observations: Vec<JudgedObservation>,
}

/// What one still scene tells of one object.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SceneAgreement {
    /// What the caller calls the scene.
    pub scene: String,
    /// Those with the most views first.
    pub instances: Vec<Instance>,
    /// Poses that stand where no other image sees the object: it was seen once only, something else was taken for it, or the pose
    /// is wrong by more than a diameter. Nothing can be said of them; they are no part of any median.
    pub alone: Vec<Found>,
}

impl SceneAgreement {
    /// Compares all poses that were found of one object in one scene. Their order does not matter.
    ///
    /// Each view is compared with the consensus of the others: with two views, both get their difference, since nothing says
    /// which of them is wrong. So deviations are larger than errors, by `sqrt(n / (n - 1))` for n equally exact views.
    ///
    /// # Errors
    /// [`AgreementError`] names the image of the pose that cannot be compared.
    pub fn of(
        scene: String,
        shape: &Shape,
        bounds: &Bounds,
        mut observations: Vec<Observation>,
    ) -> Result<Self, AgreementError> {
        observations.sort_by(Observation::order);
        let checked = observations.into_iter().map(|observation| observation.checked(shape));
        let sightings = checked.collect::<Result<Vec<_>, _>>()?;
        let mut scene = Self { scene, ..Self::default() };
        for group in groups(&sightings, shape.diameter_m()) {
            let chosen = |places: &[usize]| -> Vec<&Sighting> {
                let mut places = places.to_vec();
                places.sort_unstable();
                places.into_iter().map(|place| &sightings[place]).collect()
            };
            let Group { trusted, rejected } = &group;
            let (trusted, rejected) = (chosen(trusted), chosen(rejected));
            if trusted.len() > 1 {
                scene.instances.push(Instance::of(shape, bounds, &trusted, &rejected)?);
            } else {
                scene.alone.extend(trusted.iter().chain(&rejected).map(|sighting| Found::from(&sighting.observation)));
            }
        }
        scene.instances.sort_by_key(|instance| std::cmp::Reverse(instance.observations.len()));
        Ok(scene)
    }

    /// All poses that were compared with others.
    pub fn judged(&self) -> impl Iterator<Item = &JudgedObservation> {
        self.instances.iter().flat_map(|instance| &instance.observations)
    }
}

impl Instance {
    fn of(
        shape: &Shape,
        bounds: &Bounds,
        trusted: &[&Sighting],
        rejected: &[&Sighting],
    ) -> Result<Self, AgreementError> {
        let singular = |sighting: &Sighting| AgreementError::Covariance { image_id: sighting.observation.image_id };
        let first = trusted.first().map_or(AgreementError::Shape, |sighting| singular(sighting));
        let view_angle_deg = widest_angle(trusted).to_degrees();
        let consensus = Consensus::of(shape, trusted.to_vec()).ok_or_else(|| first.clone())?;
        let of_all = consensus.of_all().ok_or(first)?;
        let of_others = consensus.of_others().into_iter().chain(rejected.iter().map(|_| Some(of_all)));
        let judged = trusted.iter().chain(rejected).zip(of_others).map(|(sighting, others)| {
            let deviation = others.and_then(|others| ViewDeviation::new(shape, bounds, sighting, &others));
            let deviation = deviation.ok_or_else(|| singular(sighting))?;
            Ok(JudgedObservation { found: Found::from(&sighting.observation), deviation })
        });
        let mut observations = judged.collect::<Result<Vec<_>, _>>()?;
        observations.sort_by_key(|judged| judged.found.image_id);
        let world_from_object = shape.with_origin(&consensus.pose());
        Ok(Self { world_from_object, support: consensus.support(), view_angle_deg, observations })
    }
}

impl From<&Observation> for Found {
    fn from(observation: &Observation) -> Self {
        let Observation { image_id, status, confidence, world_from_object, .. } = *observation;
        Self { image_id, status, confidence, world_from_object }
    }
}

/// Largest angle between two of the rays, or a little less: from ray to ray, each the farthest from the last.
fn widest_angle(sightings: &[&Sighting]) -> f64 {
    let (mut at, mut widest) = (0, 0.0);
    for _ in 0..MAX_SWEEPS {
        let angles = sightings.iter().map(|sighting| sightings[at].ray.angle(&sighting.ray));
        let Some((farthest, angle)) = angles.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        if angle <= widest {
            break;
        }
        (at, widest) = (farthest, angle);
    }
    widest
}

fn as_file<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
    PoseFile::from(pose).serialize(serializer)
}
