//! Levenberg-Marquardt on a pose that several views see, each a step off.

use nalgebra::{Matrix6, Vector6};

use super::prepared::Prepared;
use crate::geometry::{Covariance6, Pose, parts};
use crate::pnp::{Loss, Problem, Refined};

const MAX_STEPS: usize = 20;
const MAX_DAMPING: f64 = 1e6;

/// A view that takes part.
pub(super) struct Member<'a> {
    /// Its place among all views.
    pub index: usize,
    pub view: &'a Prepared,
    /// Its points, as the one of the object's equal poses that it saw.
    pub problem: Problem,
    /// Covariance of the step by which this view may see the pose off: what all of its points share.
    pub shared: Covariance6,
    /// Below 1 where others look from the same direction: they share their errors, and count as one together.
    pub share: f64,
}

/// A pose and what the members see there.
pub(super) struct Fit {
    pub pose: Pose,
    /// Sum over the members of their points' losses and of their steps' squared lengths.
    pub cost: f64,
    pub seen: Vec<Seen>,
}

/// What one member sees.
#[derive(Clone, Copy)]
pub(super) struct Seen {
    /// The pose is this step off, and the step is `shared * pull`.
    pub step: Vector6<f64>,
    pub pull: Vector6<f64>,
    /// Normal equations of its points, along the world's axes.
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
}

/// The normal equations of the pose alone.
struct Reduced {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
    /// For each member `(I + shared * hessian)⁻¹`.
    damping: Vec<Matrix6<f64>>,
}

impl Fit {
    /// `None` where a point is behind its camera.
    fn at(
        members: &[Member<'_>],
        pose: Pose,
        steps: &[(Vector6<f64>, Vector6<f64>)],
        loss: &impl Loss,
    ) -> Option<Self> {
        let mut fit = Self { pose, cost: 0.0, seen: Vec::with_capacity(members.len()) };
        for (member, (step, pull)) in members.iter().zip(steps) {
            let (translation, rotation) = parts(step);
            let camera_from_centred = member.view.camera_from_world * pose.perturbed(&translation, &rotation);
            let Refined { cost, hessian, gradient, .. } = Refined::at(&member.problem, camera_from_centred, loss)?;
            let turn = &member.view.camera_from_world_axes;
            fit.cost += cost * member.share + pull.dot(step);
            fit.seen.push(Seen {
                step: *step,
                pull: *pull,
                hessian: turn.transpose() * hessian * turn * member.share,
                gradient: turn.transpose() * gradient * member.share,
            });
        }
        Some(fit)
    }

    /// Without the members' steps: each takes the one that is best for it, wherever the pose goes.
    fn reduced(&self, members: &[Member<'_>]) -> Option<Reduced> {
        let mut reduced = Reduced {
            hessian: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            damping: Vec::with_capacity(members.len()),
        };
        for (member, seen) in members.iter().zip(&self.seen) {
            let damping = (Matrix6::identity() + member.shared * seen.hessian).try_inverse()?;
            let own = seen.hessian * damping;
            reduced.hessian += own;
            reduced.gradient += seen.gradient - own * (seen.step + member.shared * seen.gradient);
            reduced.damping.push(damping);
        }
        // Symmetric but for rounding.
        reduced.hessian = (reduced.hessian + reduced.hessian.transpose()) * 0.5;
        Some(reduced)
    }

    /// Covariance of the pose.
    pub(super) fn covariance(&self, members: &[Member<'_>]) -> Option<Covariance6> {
        let inverse = self.reduced(members)?.hessian.cholesky()?.inverse();
        inverse.iter().all(|v| v.is_finite()).then_some(inverse)
    }

    /// Where the members' steps go if the pose takes one.
    fn follow(
        &self,
        members: &[Member<'_>],
        reduced: &Reduced,
        step: &Vector6<f64>,
    ) -> Vec<(Vector6<f64>, Vector6<f64>)> {
        let each = members.iter().zip(&self.seen).zip(&reduced.damping);
        each.map(|((member, seen), damping)| {
            let whole = damping * (step - seen.step - member.shared * seen.gradient);
            let pull = -(seen.hessian * whole + seen.gradient);
            (member.shared * pull, pull)
        })
        .collect()
    }
}

/// Lowers the cost of a pose; `None` where a point is behind its camera at the start, or nothing fixes the pose.
pub(super) fn fit(members: &[Member<'_>], start: &Start<'_>, loss: &impl Loss, tolerance: f64) -> Option<Fit> {
    let mut best = Fit::at(members, start.pose, start.steps, loss)?;
    let mut damping = 1e-9;
    for _ in 0..MAX_STEPS {
        let reduced = best.reduced(members)?;
        let (lower, decrement) = loop {
            let damped = reduced.hessian + Matrix6::from_diagonal(&(reduced.hessian.diagonal() * damping));
            let step = -damped.cholesky()?.solve(&reduced.gradient);
            let decrement = -step.dot(&reduced.gradient);
            let (translation, rotation) = parts(&step);
            let steps = best.follow(members, &reduced, &step);
            let moved = Fit::at(members, best.pose.perturbed(&translation, &rotation), &steps, loss);
            let lower = moved.filter(|moved| moved.cost <= best.cost);
            if lower.is_some() || damping > MAX_DAMPING {
                break (lower, decrement);
            }
            damping = (damping * 30.0).max(1e-3);
        };
        let Some(lower) = lower else { break };
        let gained = best.cost - lower.cost;
        best = lower;
        damping *= 0.1;
        if decrement < tolerance && gained < tolerance {
            break;
        }
    }
    Some(best)
}

/// Where to begin: a pose, and the members' steps with their pulls.
pub(super) struct Start<'a> {
    pub pose: Pose,
    pub steps: &'a [(Vector6<f64>, Vector6<f64>)],
}

impl Fit {
    /// The members' steps, to go on from.
    pub(super) fn steps(&self) -> Vec<(Vector6<f64>, Vector6<f64>)> {
        self.seen.iter().map(|seen| (seen.step, seen.pull)).collect()
    }
}
