//! From keypoints to a pose that a robot can trust, or a reason why not.

use image::RgbImage;

use super::answer::{Detection, KeypointPrediction, ObjectPose, Observed, SolvedKeypoint, SolvedPose};
use super::evidence::{self, Judgement, in_box};
use super::second_peaks::{Solved, solve};
use super::verdict::{Reason, Verdict};
use crate::model::ObjectModel;
use crate::vision::box_corners;
use posed_core::calibration::Offset;
use posed_core::geometry::{Camera, Covariance6, Pose, covariance_about, sigmas};
use posed_core::pnp::{Solution, Status};

/// A median peak (probability mass about a keypoint) below this says that the network is guessing.
const MIN_MEDIAN_PEAK: f64 = 0.25;
/// Alternatives with less posterior weight are not worth a robot's time.
const MIN_ALTERNATIVE_WEIGHT: f64 = 1e-3;
/// Reprojection error above this, in larger box sides, contradicts the pose.
const MAX_RMSE: f64 = 0.06;
/// A pose is loose when its translation's standard deviation passes this share of the object's diameter ...
const MAX_SIGMA_TRANSLATION: f64 = 0.25;
/// ... or its rotation's passes this angle.
const MAX_SIGMA_ROTATION_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// No lens in use shows an object whole from nearer than this, in its diameters: wrong camera parameters put it there.
const MIN_DISTANCE: f64 = 1.0;
/// The pose's centre may lie this far from the box's centre, in larger box sides.
const MAX_CENTRE_SHIFT: f64 = 0.5;
/// Larger box side over the object's extent at the pose's depth: smaller when foreshortened or occluded.
const BOX_TO_EXTENT: std::ops::RangeInclusive<f64> = 0.2..=1.6;

pub(super) fn object_pose(
    model: &ObjectModel,
    offset: &Offset,
    detection: Detection,
    prediction: &KeypointPrediction,
    image: &RgbImage,
    camera: &Camera,
) -> ObjectPose {
    let manifest = &model.manifest;
    let answer = |verdict, pose| ObjectPose {
        object: manifest.name.clone(),
        verdict,
        detection,
        track: None,
        pose,
        diameter_m: manifest.diameter_m,
    };
    if !prediction.is_finite() {
        let mut verdict = Verdict::default();
        verdict.object(Reason::NotFinite, Status::Rejected);
        return answer(verdict, None);
    }
    let Ok(Solved { mut solution, has_rival, readings }) = solve(manifest, prediction, camera, offset.keypoints_scale)
    else {
        let mut verdict = Verdict::default();
        verdict.object(Reason::NoPose, Status::Rejected);
        return answer(verdict, None);
    };
    let judged = evidence::judge(manifest, &detection, prediction, &solution, image, camera);
    let observed = judged.observed(&solution, readings);
    solution.covariance = judged.covariance(&solution);
    let pose = solved_pose(model, offset, &solution, prediction, observed, &judged);
    let mut verdict = Verdict::of(&solution);
    if has_rival {
        verdict.object(Reason::TwoAnswers, Status::Ambiguous);
    }
    let least = manifest.trust.as_ref().and_then(|trust| trust.ok_probability);
    if judged.probability.zip(least).is_some_and(|(probability, least)| probability < least) {
        verdict.object(Reason::Improbable, Status::LowConfidence);
    }
    if judged.evidence.peak < MIN_MEDIAN_PEAK {
        verdict.object(Reason::WeakKeypoints, Status::LowConfidence);
    }
    let in_box = in_box(solution.pose.translation(), manifest.diameter_m, &detection.bounding_box, camera);
    if !in_box.is_some_and(|(shift, size)| shift < MAX_CENTRE_SHIFT && BOX_TO_EXTENT.contains(&size)) {
        verdict.object(Reason::BoxMismatch, Status::Rejected);
    }
    if pose.reprojection_rmse_px > MAX_RMSE * detection.bounding_box.extent() {
        // Wide covariances excuse such residuals, but no pose follows from them.
        verdict.object(Reason::HighResidual, Status::Rejected);
    }
    if pose.camera_from_object.translation().norm() < MIN_DISTANCE * manifest.diameter_m {
        verdict.object(Reason::TooNear, Status::LowConfidence);
    }
    if is_loose(&pose.covariance, manifest.diameter_m) {
        verdict.object(Reason::UncertainPose, Status::LowConfidence);
    }
    answer(verdict, Some(pose))
}

fn solved_pose(
    model: &ObjectModel,
    offset: &Offset,
    solution: &Solution,
    prediction: &KeypointPrediction,
    observed: Observed,
    judged: &Judgement,
) -> SolvedPose {
    let in_user_frame = |pose: &Pose, covariance: &Covariance6| {
        let (pose, covariance) = offset.apply(pose, covariance);
        model.symmetries.canonical_with(&pose, &covariance)
    };
    let (camera_from_object, covariance) = in_user_frame(&solution.pose, &solution.covariance);
    let lever = camera_from_object.translation() - solution.pose.translation();
    let alternatives = solution.alternatives.iter().flatten().filter(|a| a.weight > MIN_ALTERNATIVE_WEIGHT);
    // Those peaks that the pose rests on.
    let pixels = observed.readings.first().map_or(&prediction.pixels, |reading| &reading.pixels);
    let keypoints = pixels.iter().zip(&prediction.peaks).zip(solution.residuals());
    SolvedPose {
        camera_from_object,
        camera_from_keypoints: solution.pose,
        covariance,
        image_covariance: covariance_about(&solution.covariance, &lever),
        reprojection_rmse_px: solution.rmse_px(),
        keypoints: keypoints
            .map(|((pixel, peak), residual)| SolvedKeypoint {
                pixel: *pixel,
                peak: *peak,
                residual_px: Some(residual.error_px.norm()).filter(|residual| residual.is_finite()),
                inlier: residual.inlier,
            })
            .collect(),
        outside_lens: solution.residuals().iter().filter(|residual| residual.outside_lens).count(),
        alternatives: alternatives.map(|a| (in_user_frame(&a.pose, &a.covariance).0, a.weight)).collect(),
        weight: solution.weight,
        observed,
        keypoints_scale: offset.keypoints_scale,
        evidence: judged.evidence,
        probability: judged.probability,
        box_in_camera: box_corners(&model.manifest.keypoints_scaled_by(offset.keypoints_scale))
            .map(|corner| solution.pose.transform(&corner)),
    }
}

/// Whether a robot should not act on a pose with this covariance.
pub(super) fn is_loose(covariance: &Covariance6, diameter_m: f64) -> bool {
    let (translation_m, rotation_rad) = sigmas(covariance);
    translation_m > MAX_SIGMA_TRANSLATION * diameter_m || rotation_rad > MAX_SIGMA_ROTATION_RAD
}
