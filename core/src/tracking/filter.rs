//! Two motions at once: an interacting multiple model.

use super::options::Options;
use super::state::{Innovation, Motion, State, mixture};
use crate::geometry::{Covariance6, Pose};

/// For how long an object stands still, and for how long it moves, on the average, seconds.
const STILL_FOR_S: f64 = 10.0;
const MOVING_FOR_S: f64 = 1.0;
/// How far what stands still gets in a second, one sigma, m and rad.
const CREEP: [f64; 2] = [1e-4, 1e-3];
/// Squared Mahalanobis distance beyond which a measurement is a jump: the 99.99 % point of chi-square with 6 degrees.
pub(super) const GATE: f64 = 27.86;
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
pub(super) struct Fit {
    innovations: [Innovation; 2],
    /// As what rests takes it.
    resting: Innovation,
    covariances: [Covariance6; 2],
}

impl Filter {
    pub(super) fn new(pose: Pose, covariance: &Covariance6, options: &Options) -> Self {
        let motions = [
            Motion::Still { creep: CREEP },
            Motion::Moving { change: [options.velocity_change_m_s, options.turn_change_rad_s] },
        ];
        let states = [State::still(pose, covariance), State::new(pose, covariance, FIRST_VELOCITY)];
        Self { states, weights: [0.5; 2], motions }
    }

    /// Of an object that was last known so many seconds ago: as it was, where it may not have moved since by the measurement with
    /// which it is found again; anew otherwise.
    pub(super) fn found_again(
        last: &(Pose, Covariance6),
        seconds: f64,
        found: &(Pose, Covariance6),
        options: &Options,
    ) -> Self {
        let mut anew = Self::new(found.0, &found.1, options);
        let mut resting = State::still(last.0, &last.1).after(seconds, anew.motions[0]);
        let unmoved = resting.innovation(&found.0, &found.1).filter(|innovation| innovation.distance() <= GATE);
        if let Some(innovation) = unmoved {
            resting.take(&innovation, &found.1);
            anew.states[0] = resting;
            anew.weights = [STILL_FOR_S, MOVING_FOR_S].map(|time| time / (STILL_FOR_S + MOVING_FOR_S));
        }
        anew
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

    /// What both motions say to a measurement whose covariance counts so many times as much to each. `None` where the covariance is none.
    pub(super) fn fit(&self, measured: &Pose, covariance: &Covariance6, alike: [f64; 2]) -> Option<Fit> {
        let [still, moving] = &self.states;
        let like = covariance * alike[1];
        let innovations = [still.innovation(measured, &like)?, moving.innovation(measured, &like)?];
        let covariances = alike.map(|factor| covariance * factor);
        // How likely both are is asked with one covariance, or the looser one would look less likely for that alone.
        let resting = still.innovation(measured, &covariances[0])?;
        Some(Fit { innovations, resting, covariances })
    }

    /// Takes a measurement.
    pub(super) fn take(&mut self, fit: &Fit) {
        let logs = [0, 1].map(|k| self.weights[k].ln() + fit.innovations[k].log_likelihood());
        let most = logs[0].max(logs[1]);
        let likely = logs.map(|log| (log - most).exp().max(LEAST_WEIGHT));
        let sum: f64 = likely.iter().sum();
        self.weights = likely.map(|one| one / sum);
        let [still, moving] = &mut self.states;
        still.take(&fit.resting, &fit.covariances[0]);
        moving.take(&fit.innovations[1], &fit.covariances[1]);
    }
}

impl Fit {
    /// The squared Mahalanobis distance of the measurement from the motion that it suits best.
    pub(super) fn distance(&self) -> f64 {
        self.innovations[0].distance().min(self.innovations[1].distance())
    }
}
