//! The pose that most views of an instance agree in.

use nalgebra::{Matrix6, Vector3, Vector6};

use super::observation::Sighting;
use super::shape::Shape;
use posed_core::geometry::{Covariance6, Pose};

/// Views this far from the consensus (a share of the diameter at the object, and an angle) have no say in it.
const WITHIN: f64 = 0.25;
const WITHIN_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Beyond this Mahalanobis distance (the 95 % ellipsoid) a view's pull grows no further (Huber).
const HUBER: f64 = 3.55;
/// Most views that are tried as a first guess, the most trusted ones.
const MAX_GUESSES: usize = 32;
const MAX_STEPS: usize = 30;
/// A step (metres, radians) after which the consensus stands.
const SETTLED: f64 = 1e-10;

/// A consensus of views, with the weight that each has in it.
pub(super) struct Consensus<'a> {
    shape: &'a Shape,
    members: Vec<&'a Sighting>,
    pose: Pose,
    /// Huber's weight of each member; 0 for those that are too far off.
    weights: Vec<f64>,
}

/// Sums over members, from which their weighted mean follows.
#[derive(Clone)]
struct Sums {
    /// `Σ w Λ`, with Λ the inverse covariance.
    information: Matrix6<f64>,
    /// `Σ w² Λ`.
    squared: Matrix6<f64>,
    /// `Σ w Λ step`.
    pull: Vector6<f64>,
}

impl<'a> Consensus<'a> {
    /// Of views in the order of trust; `None` without any.
    pub(super) fn of(shape: &'a Shape, members: Vec<&'a Sighting>) -> Option<Self> {
        let pose = best_guess(shape, &members)?;
        let mut consensus = Self { weights: vec![0.0; members.len()], shape, members, pose };
        for _ in 0..MAX_STEPS {
            let steps: Vec<_> = consensus.members.iter().map(|member| consensus.step(member)).collect();
            let weighted = consensus.members.iter().zip(&steps);
            let weights: Vec<_> = weighted.map(|(member, step)| weight(shape, member, step)).collect();
            let terms = consensus.members.iter().zip(&steps).zip(&weights);
            let sums = terms.fold(Sums::zero(), |sums, ((member, step), weight)| sums.plus(member, step, *weight));
            let Some((step, _)) = sums.mean() else { break };
            consensus.weights = weights;
            consensus.pose = moved(&consensus.pose, &step);
            if step.norm() < SETTLED {
                break;
            }
        }
        Some(consensus)
    }

    /// `world_from_object` about the object's middle.
    pub(super) fn pose(&self) -> Pose {
        self.pose
    }

    /// Number of views that it rests on.
    pub(super) fn support(&self) -> usize {
        self.weights.iter().filter(|weight| **weight > 0.0).count()
    }

    /// What all members say together: the pose and its covariance.
    pub(super) fn of_all(&self) -> Option<(Pose, Covariance6)> {
        let sums = (0..self.members.len()).fold(Sums::zero(), |sums, index| self.with(&sums, index));
        let (step, covariance) = sums.mean()?;
        Some((moved(&self.pose, &step), covariance))
    }

    /// For each member, what the others say. Where no other has a say here, the others are asked alone.
    pub(super) fn of_others(&self) -> Vec<Option<(Pose, Covariance6)>> {
        let count = self.members.len();
        // Sums of those before and those after, since taking one away from the whole would lose digits.
        let mut after = vec![Sums::zero(); count + 1];
        for index in (0..count).rev() {
            after[index] = self.with(&after[index + 1], index);
        }
        let mut before = Sums::zero();
        let mut found = Vec::with_capacity(count);
        for index in 0..count {
            let mean = before.joined(&after[index + 1]).mean();
            found.push(match mean {
                Some((step, covariance)) => Some((moved(&self.pose, &step), covariance)),
                None => self.without(index).and_then(|others| others.of_all()),
            });
            before = self.with(&before, index);
        }
        found
    }

    fn without(&self, left_out: usize) -> Option<Self> {
        let others = self.members.iter().enumerate().filter(|(index, _)| *index != left_out).map(|(_, member)| *member);
        Self::of(self.shape, others.collect())
    }

    fn with(&self, sums: &Sums, index: usize) -> Sums {
        let member = self.members[index];
        sums.plus(member, &self.step(member), self.weights[index])
    }

    fn step(&self, member: &Sighting) -> Vector6<f64> {
        self.pose.step_to(&self.shape.nearest(&member.pose, &self.pose))
    }
}

impl Sums {
    fn zero() -> Self {
        Self { information: Matrix6::zeros(), squared: Matrix6::zeros(), pull: Vector6::zeros() }
    }

    fn plus(&self, member: &Sighting, step: &Vector6<f64>, weight: f64) -> Self {
        self.joined(&Self {
            information: member.information * weight,
            squared: member.information * (weight * weight),
            pull: member.information * step * weight,
        })
    }

    fn joined(&self, other: &Self) -> Self {
        Self {
            information: self.information + other.information,
            squared: self.squared + other.squared,
            pull: self.pull + other.pull,
        }
    }

    /// The step to the mean and its covariance, `(Σ w Λ)⁻¹ (Σ w² Λ) (Σ w Λ)⁻¹`: the members' own, however they are weighted.
    fn mean(&self) -> Option<(Vector6<f64>, Covariance6)> {
        let inverse = self.information.cholesky()?.inverse();
        Some((inverse * self.pull, inverse * self.squared * inverse))
    }
}

/// The view that most others agree with.
fn best_guess(shape: &Shape, members: &[&Sighting]) -> Option<Pose> {
    let mut best: Option<(usize, f64, Pose)> = None;
    for guess in members.iter().take(MAX_GUESSES) {
        let apart = members.iter().map(|member| {
            let step = guess.pose.step_to(&shape.nearest(&member.pose, &guess.pose));
            apart(shape, &step)
        });
        let (count, sum) = apart.fold(
            (0, 0.0),
            |(count, sum), apart| {
                if apart < 1.0 { (count + 1, sum + apart) } else { (count, sum) }
            },
        );
        if best.is_none_or(|(most, least, _)| count > most || (count == most && sum < least)) {
            best = Some((count, sum, guess.pose));
        }
    }
    best.map(|(_, _, pose)| pose)
}

/// The larger of the shares of the bounds that a step takes: below 1 it is within both.
fn apart(shape: &Shape, step: &Vector6<f64>) -> f64 {
    let (translation, rotation) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
    (translation / (WITHIN * shape.diameter_m())).max(rotation / WITHIN_RAD)
}

fn weight(shape: &Shape, member: &Sighting, step: &Vector6<f64>) -> f64 {
    if apart(shape, step) >= 1.0 {
        return 0.0;
    }
    let mahalanobis = step.dot(&(member.information * step)).max(0.0).sqrt();
    if mahalanobis > HUBER { HUBER / mahalanobis } else { 1.0 }
}

fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
    let part = |first: usize| -> Vector3<f64> { step.fixed_rows::<3>(first).into_owned() };
    pose.perturbed(&part(0), &part(3))
}
