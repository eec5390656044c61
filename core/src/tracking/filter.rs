//! Two motions at once: an interacting multiple model.

use super::options::Options;
use super::state::{Innovation, Motion, State, mixture};
use crate::geometry::{Covariance6, Pose};

/// For how long an object stands still, and for how long it moves, on the average, seconds.
const STILL_FOR_S: f64 = 5.0;
const MOVING_FOR_S: f64 = 1.0;
/// How far what stands still gets in a second, one sigma, m and rad.
const CREEP: [f64; 2] = [1e-4, 1e-3];
/// Velocity of an object that was never seen before, one sigma, m/s and rad/s.
const FIRST_VELOCITY: [f64; 2] = [0.5, 2.0];
/// A motion is never ruled out, or the other one could not come back.
const LEAST_WEIGHT: f64 = 1e-6;

/// Pose and velocity of one object.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    /// Still, moving.
    states: [State; 2],
    weights: [f64; 2],
    motions: [Motion; 2],
}

/// A measurement as both motions see it.
pub(super) struct Fit([Innovation; 2]);

impl Filter {
    pub(super) fn new(pose: Pose, covariance: &Covariance6, options: &Options) -> Self {
        let motions = [
            Motion::Still { creep: CREEP },
            Motion::Moving { change: [options.velocity_change_m_s, options.turn_change_rad_s] },
        ];
        let states = [State::still(pose, covariance), State::new(pose, covariance, FIRST_VELOCITY)];
        Self { states, weights: [0.5; 2], motions }
    }

    /// So many seconds later.
    pub(super) fn after(&self, seconds: f64) -> Self {
        let (rest, go) = (1.0 - (-seconds / MOVING_FOR_S).exp(), 1.0 - (-seconds / STILL_FOR_S).exp());
        // change[i][j]: from motion i to motion j.
        let change = [[1.0 - go, go], [rest, 1.0 - rest]];
        let into = |to: usize| [0, 1].map(|from| change[from][to] * self.weights[from]);
        let weights = [0, 1].map(|to| into(to).iter().sum::<f64>());
        let states = [0, 1].map(|to| {
            let share = into(to).map(|part| part / weights[to]);
            let mixed = mixture(&[(share[0], &self.states[0]), (share[1], &self.states[1])]);
            mixed.after(seconds, self.motions[to])
        });
        Self { states, weights, motions: self.motions }
    }

    pub(super) fn mean(&self) -> State {
        mixture(&[(self.weights[0], &self.states[0]), (self.weights[1], &self.states[1])])
    }

    /// `None` where the covariance is none.
    pub(super) fn fit(&self, measured: &Pose, covariance: &Covariance6) -> Option<Fit> {
        let [still, moving] = &self.states;
        Some(Fit([still.innovation(measured, covariance)?, moving.innovation(measured, covariance)?]))
    }

    /// Takes a measurement.
    pub(super) fn take(&mut self, fit: &Fit, covariance: &Covariance6) {
        let logs = [0, 1].map(|k| self.weights[k].ln() + fit.0[k].log_likelihood());
        let most = logs[0].max(logs[1]);
        let likely = logs.map(|log| (log - most).exp().max(LEAST_WEIGHT));
        let sum: f64 = likely.iter().sum();
        self.weights = likely.map(|one| one / sum);
        for (state, innovation) in self.states.iter_mut().zip(&fit.0) {
            state.take(innovation, covariance);
        }
    }
}

impl Fit {
    /// The squared Mahalanobis distance of the measurement from the motion that it suits best.
    pub(super) fn distance(&self) -> f64 {
        self.0[0].distance().min(self.0[1].distance())
    }
}
