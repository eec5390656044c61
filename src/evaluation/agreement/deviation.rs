use nalgebra::{DMatrix, DVector, Unit, Vector3};
use serde::Serialize;

use super::observation::Sighting;
use super::shape::Shape;
use crate::evaluation::across::across;
use posed_core::geometry::{Covariance6, Pose};

/// Upper 5 % of the chi-squared distribution with 1 to 6 degrees of freedom.
const CHI2_95: [f64; 6] = [3.841, 5.991, 7.815, 9.488, 11.070, 12.592];

/// Beyond these a pose disagrees with the other views of its instance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// Distance of the object's middle, as a share of the diameter.
    pub translation_of_diameter: f64,
    pub rotation_deg: f64,
    /// From this angle on a pose counts as flipped.
    pub flip_deg: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { translation_of_diameter: 0.1, rotation_deg: 10.0, flip_deg: 45.0 }
    }
}

/// How far a pose is from what the other views of its instance say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ViewDeviation {
    /// Distance of the object's middle, metres.
    pub translation_m: f64,
    /// Its part along the camera's ray: positive where this image sees the object farther away than the others do.
    pub depth_m: f64,
    /// Its part across the ray.
    pub lateral_m: f64,
    /// Of the pose that looks like this one and is turned least from the others.
    pub rotation_deg: f64,
    pub nees: Nees,
    /// Turned by [`Bounds::flip_deg`] or more.
    pub flipped: bool,
    /// Beyond one of the [`Bounds`].
    pub disagrees: bool,
}

/// Normalised estimation error squared: `eᵀ Σ⁻¹ e`, with Σ the covariance of this pose and that of what the others say. Its mean is
/// its number of degrees of freedom if the covariances are true.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Nees {
    pub total: f64,
    /// 6; 5 for an object of revolution.
    pub degrees_of_freedom: usize,
    /// Along the ray: one degree of freedom.
    pub depth: f64,
    /// Across the ray: two.
    pub lateral: f64,
    /// Three; two for an object of revolution.
    pub rotation: f64,
    /// Whether the total is within the 95 % ellipsoid.
    pub within_95: bool,
}

impl ViewDeviation {
    /// `others` is `world_from_object` about the object's middle, with its covariance. `None` where the covariances are singular.
    pub(super) fn new(
        shape: &Shape,
        bounds: &Bounds,
        sighting: &Sighting,
        (others, of_others): &(Pose, Covariance6),
    ) -> Option<Self> {
        let pose = shape.nearest(&sighting.pose, others);
        let step = others.step_to(&pose);
        let covariance = sighting.covariance + of_others;
        let translation: Vector3<f64> = step.fixed_rows::<3>(0).into_owned();
        let translation_m = translation.norm();
        let depth_m = translation.dot(&sighting.ray);
        let rotation_deg = others.angle_to(&pose).to_degrees();
        let bound_m = bounds.translation_of_diameter * shape.diameter_m();
        Some(Self {
            translation_m,
            depth_m,
            lateral_m: (translation - *sighting.ray * depth_m).norm(),
            rotation_deg,
            nees: Nees::new(step.as_slice(), &covariance, &sighting.ray, shape.axis(&pose))?,
            flipped: rotation_deg >= bounds.flip_deg,
            disagrees: translation_m > bound_m || rotation_deg > bounds.rotation_deg,
        })
    }
}

impl Nees {
    fn new(
        step: &[f64],
        covariance: &Covariance6,
        ray: &Unit<Vector3<f64>>,
        axis: Option<Unit<Vector3<f64>>>,
    ) -> Option<Self> {
        let along = |first: usize, directions: &[Vector3<f64>]| -> Vec<[f64; 6]> {
            let row = |direction: &Vector3<f64>| {
                let mut row = [0.0; 6];
                row[first..first + 3].copy_from_slice(direction.as_slice());
                row
            };
            directions.iter().map(row).collect()
        };
        let depth = along(0, &[**ray]);
        let lateral = along(0, &across(ray));
        let rotation = match axis {
            None => along(3, &[Vector3::x(), Vector3::y(), Vector3::z()]),
            Some(axis) => along(3, &across(&axis)),
        };
        let all = [&depth[..], &lateral, &rotation].concat();
        let within = |rows: &[[f64; 6]]| squared(step, covariance, rows);
        let (total, degrees_of_freedom) = (within(&all)?, all.len());
        Some(Self {
            total,
            degrees_of_freedom,
            depth: within(&depth)?,
            lateral: within(&lateral)?,
            rotation: within(&rotation)?,
            within_95: total <= CHI2_95[degrees_of_freedom - 1],
        })
    }
}

/// Squared Mahalanobis length of a step's components along some directions.
fn squared(step: &[f64], covariance: &Covariance6, rows: &[[f64; 6]]) -> Option<f64> {
    let onto = DMatrix::from_fn(rows.len(), 6, |row, column| rows[row][column]);
    let error = &onto * DVector::from_column_slice(step);
    let spread = &onto * covariance * onto.transpose();
    Some(error.dot(&spread.cholesky()?.solve(&error))).filter(|value| value.is_finite())
}
