//! How large an object is, from reference images of it.

use posed_core::calibration::Offset;
use posed_core::geometry::{Camera, Pose};
use posed_core::views::{Scale, View, ViewsOptions, solve_views};

use super::instance::TEMPERING;
use crate::estimator::answer::{KeypointPrediction, Observed};
use crate::estimator::evidence::unjudged;
use crate::estimator::second_peaks::{Solved, first_reading, solve};
use crate::model::ObjectModel;

/// A reference image with its keypoints.
pub struct LocatedView {
    pub camera: Camera,
    pub camera_from_object: Pose,
    pub prediction: KeypointPrediction,
}

/// Gauss-Newton steps in scale.
const STEPS: usize = 3;

/// How much larger the images show an object than its network says, from what they all say together: the cameras stand where the
/// object's stated poses put them. `offset` is what the same images gave. `None` from fewer than three images that agree, or
/// if all look from nearly one direction.
#[must_use]
pub fn fit_keypoints_scale(model: &ObjectModel, views: &[&LocatedView], offset: &Offset) -> Option<Scale> {
    let symmetries = model.symmetries.in_frame(&offset.object_from_keypoints.inverse());
    let mut fitted = Scale { value: offset.keypoints_scale, sigma: 0.0 };
    for _ in 0..STEPS {
        let points = model.manifest.keypoints_scaled_by(fitted.value);
        let observed = |view: &&LocatedView| match solve(&model.manifest, &view.prediction, &view.camera, fitted.value)
        {
            Ok(Solved { solution, readings, .. }) => unjudged(&solution, readings),
            Err(_) => Observed { readings: vec![first_reading(&view.prediction)], modes: Vec::new() },
        };
        let observed: Vec<Observed> = views.iter().map(observed).collect();
        let all: Vec<View<'_>> = views
            .iter()
            .zip(&observed)
            .map(|(view, observed)| View {
                camera: &view.camera,
                world_from_camera: view.camera_from_object.inverse(),
                camera_covariance: None,
                readings: &observed.readings,
                modes: &observed.modes,
                trust: 1.0,
            })
            .collect();
        let options = ViewsOptions { tempering: TEMPERING, ..ViewsOptions::default() };
        let scale = solve_views(&points, &all, &symmetries, &options).ok()?.scale?;
        fitted = Scale { value: fitted.value * scale.value, sigma: fitted.value * scale.sigma };
    }
    Some(fitted)
}
