//! One motion's Kalman filter on SE(3).

use nalgebra::{Cholesky, Const, Matrix3, Matrix6, Rotation3, SMatrix, SVector, Vector3, Vector6};

use crate::geometry::{Covariance6, Pose, parts};

pub(super) type Vector12 = SVector<f64, 12>;
pub(super) type Matrix12 = SMatrix<f64, 12, 12>;

/// A pose and its velocity with the covariance of their errors: a step of the pose ([`Pose::perturbed`]), then the errors
/// of the velocity.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub pose: Pose,
    /// m/s and rad/s along the axes of the world.
    pub velocity: Vector6<f64>,
    pub covariance: Matrix12,
}

/// How an object moves between two frames.
#[derive(Clone, Copy, Debug)]
pub(super) enum Motion {
    /// Not at all, but for a creep (m and rad in a second, one sigma): cameras' poses drift, tables are touched.
    Still { creep: [f64; 2] },
    /// With a velocity that changes by so much in a second, one sigma (m/s and rad/s).
    Moving { change: [f64; 2] },
}

/// What a measurement says to a state.
pub(super) struct Innovation {
    /// From the predicted pose to the measured one.
    step: Vector6<f64>,
    factor: Cholesky<f64, Const<6>>,
}

/// Velocity of what stands still, one sigma, m/s and rad/s: not zero, so that covariances keep an inverse.
const STILL_SIGMA: f64 = 1e-6;

/// `diag(a, a, a, b, b, b)`.
pub(super) fn diagonal([a, b]: [f64; 2]) -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(a, a, a, b, b, b))
}

impl State {
    pub(super) fn new(pose: Pose, covariance: &Covariance6, velocity_sigma: [f64; 2]) -> Self {
        let mut all = Matrix12::zeros();
        all.fixed_view_mut::<6, 6>(0, 0).copy_from(covariance);
        all.fixed_view_mut::<6, 6>(6, 6).copy_from(&diagonal(velocity_sigma.map(|sigma| sigma * sigma)));
        Self { pose, velocity: Vector6::zeros(), covariance: all }
    }

    pub(super) fn still(pose: Pose, covariance: &Covariance6) -> Self {
        Self::new(pose, covariance, [STILL_SIGMA; 2])
    }

    pub(super) fn pose_covariance(&self) -> Covariance6 {
        self.covariance.fixed_view::<6, 6>(0, 0).into_owned()
    }

    /// So many seconds later.
    pub(super) fn after(&self, seconds: f64, motion: Motion) -> Self {
        match motion {
            Motion::Still { creep } => {
                let crept = diagonal(creep.map(|sigma| sigma * sigma * seconds));
                Self::still(self.pose, &(self.pose_covariance() + crept))
            }
            Motion::Moving { change } => self.moved(seconds, change),
        }
    }

    fn moved(&self, seconds: f64, change: [f64; 2]) -> Self {
        let (shift, turn) = parts(&(self.velocity * seconds));
        let mut transition = Matrix12::identity();
        // A turn's error is turned with the object; that of its velocity adds up, to first order of the turn in one frame.
        let turned: Matrix3<f64> = Rotation3::new(turn).into_inner();
        transition.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
        transition.fixed_view_mut::<6, 6>(0, 6).copy_from(&(Matrix6::identity() * seconds));
        let mut covariance = transition * self.covariance * transition.transpose();
        // A velocity that walks at random (white acceleration), integrated over the time between two frames.
        let walk = diagonal(change.map(|sigma| sigma * sigma));
        for (row, column, factor) in [
            (0, 0, seconds.powi(3) / 3.0),
            (0, 6, seconds.powi(2) / 2.0),
            (6, 0, seconds.powi(2) / 2.0),
            (6, 6, seconds),
        ] {
            let mut block = covariance.fixed_view_mut::<6, 6>(row, column);
            block += walk * factor;
        }
        Self { pose: self.pose.perturbed(&shift, &turn), velocity: self.velocity, covariance }
    }

    /// `None` where the covariances have no inverse.
    pub(super) fn innovation(&self, measured: &Pose, covariance: &Covariance6) -> Option<Innovation> {
        let factor = (self.pose_covariance() + covariance).cholesky()?;
        let step = self.pose.step_to(measured);
        step.iter().all(|value| value.is_finite()).then_some(Innovation { step, factor })
    }

    /// Takes a measurement.
    pub(super) fn take(&mut self, innovation: &Innovation, covariance: &Covariance6) {
        let of_pose = self.covariance.fixed_columns::<6>(0).into_owned();
        let gain = innovation.factor.solve(&of_pose.transpose()).transpose();
        let correction: Vector12 = gain * innovation.step;
        self.shift(&correction);
        // Joseph's form stays positive definite, whatever rounding does.
        let mut kept = Matrix12::identity();
        let mut taken = kept.fixed_columns_mut::<6>(0);
        taken -= gain;
        self.covariance = kept * self.covariance * kept.transpose() + gain * covariance * gain.transpose();
    }

    /// The error of another state, seen from this one.
    pub(super) fn step_to(&self, other: &Self) -> Vector12 {
        let mut step = Vector12::zeros();
        step.fixed_rows_mut::<6>(0).copy_from(&self.pose.step_to(&other.pose));
        step.fixed_rows_mut::<6>(6).copy_from(&(other.velocity - self.velocity));
        step
    }

    pub(super) fn shift(&mut self, step: &Vector12) {
        let (shift, turn): (Vector3<f64>, Vector3<f64>) = parts(&step.fixed_rows::<6>(0).into_owned());
        self.pose = self.pose.perturbed(&shift, &turn);
        self.velocity += step.fixed_rows::<6>(6);
    }
}

impl Innovation {
    /// The squared Mahalanobis distance of the measurement: 6 degrees of freedom.
    pub(super) fn distance(&self) -> f64 {
        self.step.dot(&self.factor.solve(&self.step))
    }

    /// Logarithm of how likely the measurement was, but for a constant.
    pub(super) fn log_likelihood(&self) -> f64 {
        let log_root_determinant: f64 = self.factor.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum();
        -0.5 * self.distance() - log_root_determinant
    }
}

/// Mean and covariance of several states, by their weights, which add up to 1.
pub(super) fn mixture(states: &[(f64, &State)]) -> State {
    let heaviest = states.iter().fold(states[0], |best, one| if one.0 > best.0 { *one } else { best }).1;
    let steps: Vec<Vector12> = states.iter().map(|(_, state)| heaviest.step_to(state)).collect();
    let mean: Vector12 = states.iter().zip(&steps).map(|((weight, _), step)| step * *weight).sum();
    let spread = states.iter().zip(&steps).map(|((weight, state), step)| {
        let apart = step - mean;
        (state.covariance + apart * apart.transpose()) * *weight
    });
    let covariance = spread.sum();
    let mut mixed = State { pose: heaviest.pose, velocity: heaviest.velocity, covariance };
    mixed.shift(&mean);
    mixed
}
