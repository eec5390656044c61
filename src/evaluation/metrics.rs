//! Accuracy of poses as the field defines it: Hinterstoisser et al. (ACCV 2012) for ADD and ADD-S.

use nalgebra::Vector3;

use super::mesh::ObjectModel;
use crate::geometry::Pose;

const ADD_SHARE_OF_DIAMETER: f64 = 0.1;

/// How far one estimate is from the truth.
#[derive(Clone, Copy, Debug)]
pub struct PoseError {
    /// ADD, or ADD-S for a symmetric object, metres.
    pub add_m: f64,
    pub rotation_deg: f64,
    pub translation_m: f64,
}

impl PoseError {
    #[must_use]
    pub fn new(model: &ObjectModel, estimate: &Pose, truth: &Pose) -> Self {
        Self {
            add_m: add(model, estimate, truth),
            rotation_deg: estimate.angle_to(truth).to_degrees(),
            translation_m: (estimate.translation() - truth.translation()).norm(),
        }
    }
}

/// Mean distance of the vertices under both poses; to the closest vertex for a symmetric object. Metres.
#[must_use]
pub fn add(model: &ObjectModel, estimate: &Pose, truth: &Pose) -> f64 {
    let estimated: Vec<Vector3<f64>> = model.vertices.iter().map(|v| estimate.transform(v)).collect();
    let sum: f64 = model
        .vertices
        .iter()
        .enumerate()
        .map(|(index, vertex)| {
            let true_point = truth.transform(vertex);
            if model.symmetric {
                estimated.iter().map(|e| (e - true_point).norm_squared()).fold(f64::INFINITY, f64::min).sqrt()
            } else {
                (estimated[index] - true_point).norm()
            }
        })
        .sum();
    let count = model.vertices.len() as f64;
    sum / count
}

/// Accuracy over many views.
#[derive(Clone, Debug)]
pub struct Score {
    /// Views, solved or not.
    pub views: usize,
    /// Share with ADD(-S) below a tenth of the diameter.
    pub add: f64,
    /// Share within 5 degrees and 5 cm.
    pub deg5_cm5: f64,
    pub median_rotation_deg: f64,
    pub median_translation_m: f64,
}

impl Score {
    /// `None` stands for a view without an answer: it counts as wrong.
    #[must_use]
    pub fn of(errors: &[Option<PoseError>], model: &ObjectModel) -> Self {
        let share = |right: &dyn Fn(&PoseError) -> bool| {
            errors.iter().flatten().filter(|e| right(e)).count() as f64 / errors.len().max(1) as f64
        };
        let median = |value: &dyn Fn(&PoseError) -> f64| {
            let mut values: Vec<f64> = errors.iter().map(|e| e.as_ref().map_or(f64::INFINITY, value)).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::INFINITY)
        };
        Self {
            views: errors.len(),
            add: share(&|e| e.add_m < ADD_SHARE_OF_DIAMETER * model.diameter_m),
            deg5_cm5: share(&|e| e.rotation_deg < 5.0 && e.translation_m < 0.05),
            median_rotation_deg: median(&|e| e.rotation_deg),
            median_translation_m: median(&|e| e.translation_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn bar(symmetric: bool) -> ObjectModel {
        let vertices = [-1.0, -0.5, 0.5, 1.0].map(|x| Vector3::new(0.05 * x, 0.0, 0.0)).to_vec();
        ObjectModel { vertices, diameter_m: 0.1, symmetric }
    }

    #[test]
    fn truth_scores_full_marks() {
        let truth = Pose::new(Rotation3::new(Vector3::new(0.3, 0.2, 0.1)), Vector3::new(0.0, 0.1, 0.6));
        for symmetric in [false, true] {
            let model = bar(symmetric);
            let score = Score::of(&[Some(PoseError::new(&model, &truth, &truth)); 3], &model);
            assert_eq!((score.add, score.deg5_cm5), (1.0, 1.0));
        }
    }

    #[test]
    fn a_symmetric_turn_is_wrong_only_without_symmetry() {
        let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
        let turned = Pose::new(Rotation3::new(Vector3::new(0.0, 0.0, std::f64::consts::PI)), *truth.translation());
        assert!(add(&bar(false), &turned, &truth) > 0.05);
        assert!(add(&bar(true), &turned, &truth) < 1e-9);
    }

    #[test]
    fn a_shift_is_measured_in_metres_and_no_answer_is_wrong() {
        let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
        let shifted = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.009, 0.6));
        let model = bar(false);
        let error = PoseError::new(&model, &shifted, &truth);
        assert!((error.add_m - 0.009).abs() < 1e-12);
        assert!((Score::of(&[Some(error), None], &model).add - 0.5).abs() < 1e-12);
    }
}
