//! How large an object is, from reference images of it.

use posed_core::calibration::{Averaged, Offset};
use posed_core::geometry::{Camera, Pose};
use posed_core::views::{Scale, View, ViewsOptions, solve_views};

use super::instance::TEMPERING;
use crate::estimator::answer::{KeypointPrediction, Observed};
use crate::estimator::evidence::unjudged;
use crate::estimator::second_peaks::{Solved, first_reading, solve};
use crate::model::{KEYPOINTS_SCALE, ObjectModel};

/// A reference image with its keypoints.
pub struct LocatedView {
    pub camera: Camera,
    pub camera_from_object: Pose,
    pub prediction: KeypointPrediction,
}

/// Gauss-Newton steps in scale.
const STEPS: usize = 3;
/// How often offset and scale follow from each other.
const ROUNDS: usize = 3;

/// The offset of reference images and the scale of their keypoints that suit each other: a wrong scale moves the offset, by which
/// is known what looks like what, and which image is wrong. `averaged` is the offset to begin with, and `average` gives that of
/// another scale.
///
/// `None` from fewer than three images that agree, if all look from nearly one direction, or if the scale is none that a
/// reference can have.
pub fn fit_offset_and_scale(
    model: &ObjectModel,
    views: &[&LocatedView],
    averaged: &Averaged,
    average: impl Fn(f64) -> Option<Averaged>,
) -> Option<(Averaged, Scale)> {
    let fit = |views: &[&LocatedView], offset: &Offset| {
        let scale = fit_keypoints_scale(model, views, offset).filter(|scale| KEYPOINTS_SCALE.contains(&scale.value))?;
        Some((average(scale.value)?, scale))
    };
    // At a wrong scale right images contradict each other, so all have their say at first.
    let mut fitted = fit(views, &averaged.offset)?;
    for _ in 1..ROUNDS {
        let Averaged { offset, residuals } = &fitted.0;
        let agreeing = views.iter().zip(residuals).filter(|(_, residual)| residual.inlier);
        fitted = fit(&agreeing.map(|(view, _)| *view).collect::<Vec<_>>(), offset)?;
    }
    Some(fitted)
}

/// How much larger the images show an object than its network says, from what they all say together: the cameras stand where the
/// object's stated poses put them. `offset` is what the same images gave. `None` from fewer than three images that agree, or
/// if all look from nearly one direction.
fn fit_keypoints_scale(model: &ObjectModel, views: &[&LocatedView], offset: &Offset) -> Option<Scale> {
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
