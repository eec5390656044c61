//! Accuracy of poses as the field defines it: Hinterstoisser et al. (ACCV 2012) for ADD and ADD-S, Brachmann et al.
//! (CVPR 2016) for Proj-5.

use nalgebra::{Vector2, Vector3};

use super::mesh::ObjectMesh;
use posed_core::geometry::{Camera, Pose};

const ADD_SHARE_OF_DIAMETER: f64 = 0.1;

/// How far one estimate is from the truth.
#[derive(Clone, Copy, Debug)]
pub struct Deviation {
    /// ADD, or ADD-S for a symmetric object, metres.
    pub add_m: f64,
    /// Mean distance of the vertices' projections (of the closest ones for a symmetric object), pixels; infinite where a
    /// vertex has no projection.
    pub projection_px: f64,
    /// From the pose that looks like the estimate and is nearest to the truth.
    pub rotation_deg: f64,
    pub translation_m: f64,
}

impl Deviation {
    #[must_use]
    pub fn new(model: &ObjectMesh, camera: &Camera, estimate: &Pose, truth: &Pose) -> Self {
        let nearest = model.symmetries.nearest(estimate, truth);
        Self {
            add_m: add(model, estimate, truth),
            projection_px: projection(model, camera, estimate, truth).unwrap_or(f64::INFINITY),
            rotation_deg: nearest.angle_to(truth).to_degrees(),
            translation_m: (nearest.translation() - truth.translation()).norm(),
        }
    }
}

/// Mean distance of the vertices under both poses; to the closest vertex for a symmetric object. Metres.
#[must_use]
pub fn add(model: &ObjectMesh, estimate: &Pose, truth: &Pose) -> f64 {
    let moved = |pose: &Pose| -> Vec<Vector3<f64>> { model.vertices.iter().map(|v| pose.transform(v)).collect() };
    mean_distance(&moved(estimate), &moved(truth), !model.symmetries.is_trivial(), |a, b| (a - b).norm_squared())
}

fn projection(model: &ObjectMesh, camera: &Camera, estimate: &Pose, truth: &Pose) -> Option<f64> {
    let pixels = |pose: &Pose| -> Option<Vec<Vector2<f64>>> {
        model.vertices.iter().map(|v| camera.project(&pose.transform(v)).ok()).collect()
    };
    let squared = |a: &Vector2<f64>, b: &Vector2<f64>| (a - b).norm_squared();
    Some(mean_distance(&pixels(estimate)?, &pixels(truth)?, !model.symmetries.is_trivial(), squared))
}

/// Mean distance of true points from their estimates, or from the closest estimate of any.
fn mean_distance<T>(estimated: &[T], truth: &[T], closest: bool, squared: impl Fn(&T, &T) -> f64) -> f64 {
    let distance = |(index, point): (usize, &T)| {
        let nearest = if closest {
            estimated.iter().map(|other| squared(other, point)).fold(f64::INFINITY, f64::min)
        } else {
            squared(&estimated[index], point)
        };
        nearest.sqrt()
    };
    truth.iter().enumerate().map(distance).sum::<f64>() / truth.len() as f64
}

/// Accuracy over many views.
#[derive(Clone, Debug)]
pub struct Score {
    /// Views, solved or not.
    pub views: usize,
    /// Share with ADD(-S) below a tenth of the diameter.
    pub add: f64,
    /// Share with projections within 5 pixels.
    pub proj5: f64,
    /// Share within 5 degrees and 5 cm.
    pub deg5_cm5: f64,
    pub median_rotation_deg: f64,
    pub median_translation_m: f64,
}

impl Score {
    /// `None` stands for a view without an answer: it counts as wrong.
    #[must_use]
    pub fn of(errors: &[Option<Deviation>], model: &ObjectMesh) -> Self {
        let share = |right: &dyn Fn(&Deviation) -> bool| {
            errors.iter().flatten().filter(|e| right(e)).count() as f64 / errors.len().max(1) as f64
        };
        let median = |value: &dyn Fn(&Deviation) -> f64| {
            let mut values: Vec<f64> = errors.iter().map(|e| e.as_ref().map_or(f64::INFINITY, value)).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::INFINITY)
        };
        Self {
            views: errors.len(),
            add: share(&|e| e.add_m < ADD_SHARE_OF_DIAMETER * model.diameter_m),
            proj5: share(&|e| e.projection_px < 5.0),
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
    use posed_core::geometry::Symmetries;

    fn bar(symmetric: bool) -> ObjectMesh {
        let vertices = [-1.0, -0.5, 0.5, 1.0].map(|x| Vector3::new(0.05 * x, 0.0, 0.0)).to_vec();
        let half_turn = Pose::new(Rotation3::new(Vector3::z() * std::f64::consts::PI), Vector3::zeros());
        let symmetries =
            if symmetric { Symmetries::new(&[half_turn], Vec::new()).unwrap() } else { Symmetries::default() };
        ObjectMesh { vertices, diameter_m: 0.1, symmetries }
    }

    fn error(model: &ObjectMesh, estimate: &Pose, truth: &Pose) -> Deviation {
        Deviation::new(model, &Camera::pinhole(600.0, 600.0, 319.5, 239.5).unwrap(), estimate, truth)
    }

    #[test]
    fn truth_scores_full_marks() {
        let truth = Pose::new(Rotation3::new(Vector3::new(0.3, 0.2, 0.1)), Vector3::new(0.0, 0.1, 0.6));
        for symmetric in [false, true] {
            let model = bar(symmetric);
            let score = Score::of(&[Some(error(&model, &truth, &truth)); 3], &model);
            assert_eq!((score.add, score.proj5, score.deg5_cm5), (1.0, 1.0, 1.0));
        }
    }

    #[test]
    fn a_symmetric_turn_is_wrong_only_without_symmetry() {
        let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
        let turned = Pose::new(Rotation3::new(Vector3::new(0.0, 0.0, std::f64::consts::PI)), *truth.translation());
        let [wrong, right] = [false, true].map(|symmetric| error(&bar(symmetric), &turned, &truth));
        assert!(wrong.add_m > 0.05 && wrong.projection_px > 50.0 && wrong.rotation_deg > 179.0);
        assert!(right.add_m < 1e-9 && right.projection_px < 1e-6 && right.rotation_deg < 1e-6);
    }

    #[test]
    fn a_shift_is_measured_in_metres_and_pixels_and_no_answer_is_wrong() {
        let truth = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.0, 0.6));
        let shifted = Pose::new(Rotation3::identity(), Vector3::new(0.0, 0.009, 0.6));
        let model = bar(false);
        let error = error(&model, &shifted, &truth);
        assert!((error.add_m - 0.009).abs() < 1e-12);
        assert!((error.projection_px - 9.0).abs() < 1e-9);
        let score = Score::of(&[Some(error), None], &model);
        assert_eq!((score.add, score.proj5, score.deg5_cm5), (0.5, 0.0, 0.5));
    }
}
