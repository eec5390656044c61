use std::time::{Duration, Instant};

use fast_image_resize::Resizer;
use image::RgbImage;
use nalgebra::{Matrix2, Vector2};
use thiserror::Error;

use crate::calibration::Offset;
use crate::geometry::{Affine, Camera, CameraError, Covariance6, Pose, covariance_about};
use crate::model::{Detector, KeypointManifest, KeypointModel, RuntimeError, Store};
use crate::pnp::{self, PnpError, Reason, Solution, Status, Verdict};
use crate::vision::{BoundingBox, ResampleError, Resampled, crop_square, letterbox};

/// More objects than this in one image are dropped, weakest first.
const MAX_DETECTIONS: usize = 32;
/// Boxes with a larger intersection over union are one object.
const SAME_PLACE_OVERLAP: f64 = 0.7;
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
/// The pose's centre may lie this far from the box's centre, in larger box sides.
const MAX_CENTRE_SHIFT: f64 = 0.5;
/// Larger box side over the object's extent at the pose's depth: smaller when foreshortened or occluded.
const BOX_TO_EXTENT: std::ops::RangeInclusive<f64> = 0.2..=1.6;

/// An image that cannot be estimated from.
#[derive(Debug, Error)]
pub enum EstimateError {
    #[error(transparent)]
    Camera(#[from] CameraError),
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    #[error(transparent)]
    Resample(#[from] ResampleError),
}

/// What the detector saw.
#[derive(Clone, Copy, Debug)]
pub struct Detection {
    /// Index of the object in the store.
    pub object: usize,
    /// Box of the visible part, image pixels.
    pub bounding_box: BoundingBox,
    /// 0..1.
    pub score: f64,
}

/// What a keypoint net says, in image pixels.
#[derive(Clone, Debug)]
pub struct KeypointPrediction {
    pub pixels: Vec<Vector2<f64>>,
    /// Calibrated 2x2 covariances, px².
    pub covariances: Vec<Matrix2<f64>>,
    /// Probability mass about each keypoint, 0..1.
    pub peaks: Vec<f64>,
}

/// One detected object with its pose.
#[derive(Clone, Debug)]
pub struct ObjectPose {
    pub object: String,
    pub verdict: Verdict,
    pub detection: Detection,
    /// `None` when no pose could be solved at all.
    pub pose: Option<SolvedPose>,
    /// The object's extent, metres: for pictures.
    pub diameter_m: f64,
}

/// A pose in the user's frame.
#[derive(Clone, Debug)]
pub struct SolvedPose {
    pub camera_from_object: Pose,
    pub covariance: Covariance6,
    pub reprojection_rmse_px: f64,
    pub inliers: usize,
    pub keypoints: usize,
    /// Other poses with their posterior weights.
    pub alternatives: Vec<(Pose, f64)>,
    /// Posterior weight of this pose among the alternatives.
    pub weight: f64,
}

/// Time spent in each stage.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    pub detect: Duration,
    pub keypoints: Duration,
    pub pose: Duration,
}

/// The answer to one image.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub width: u32,
    pub height: u32,
    pub poses: Vec<ObjectPose>,
    pub timings: Timings,
}

/// The whole pipeline on one thread: it owns its networks.
pub struct Estimator {
    store: Store,
    resizer: Resizer,
    options: pnp::Options,
}

impl Estimator {
    #[must_use]
    pub fn new(store: Store) -> Self {
        let options = pnp::Options { max_sigma_rotation_rad: MAX_SIGMA_ROTATION_RAD, ..pnp::Options::default() };
        Self { store, resizer: Resizer::new(), options }
    }

    /// Finds all calibrated objects in an image, the most trusted poses first. `camera` belongs to this image.
    ///
    /// # Errors
    /// When the camera belongs to another image size, or a network fails.
    pub fn estimate(&mut self, image: &RgbImage, camera: &Camera) -> Result<Estimate, EstimateError> {
        camera.check_image_size(image.width(), image.height())?;
        let mut timings = Timings::default();
        let start = Instant::now();
        let detections = detect(&mut self.store.detector, &mut self.resizer, image)?;
        timings.detect = start.elapsed();
        let mut poses = Vec::new();
        for (index, model) in self.store.objects.iter_mut().enumerate() {
            let Some(model) = model else { continue };
            let Some(offset) = model.reference.as_ref().map(|reference| reference.offset.clone()) else { continue };
            let found: Vec<Detection> = detections.iter().filter(|d| d.object == index).copied().collect();
            let boxes: Vec<BoundingBox> = found.iter().map(|d| d.bounding_box).collect();
            let start = Instant::now();
            let predictions = predict_keypoints(model, &mut self.resizer, image, &boxes)?;
            timings.keypoints += start.elapsed();
            let start = Instant::now();
            for (detection, prediction) in found.into_iter().zip(&predictions) {
                poses.push(object_pose(model, &offset, detection, prediction, camera, &self.options));
            }
            timings.pose += start.elapsed();
        }
        poses.sort_by(|a, b| {
            a.verdict.status.cmp(&b.verdict.status).then(b.detection.score.total_cmp(&a.detection.score))
        });
        Ok(Estimate { width: image.width(), height: image.height(), poses, timings })
    }
}

/// Solves the pose of an object's virtual keypoints, `camera_from_keypoints`, within one box.
///
/// # Errors
/// When the network fails on the box, or no pose fits its keypoints (inner result).
pub fn solve_object(
    model: &mut KeypointModel,
    image: &RgbImage,
    region: &BoundingBox,
    camera: &Camera,
) -> Result<Result<Solution, PnpError>, EstimateError> {
    camera.check_image_size(image.width(), image.height())?;
    let predictions = predict_keypoints(model, &mut Resizer::new(), image, std::slice::from_ref(region))?;
    Ok(solve_keypoints(&model.manifest, &predictions[0], camera, &pnp::Options::default()))
}

fn detect(detector: &mut Detector, resizer: &mut Resizer, image: &RgbImage) -> Result<Vec<Detection>, EstimateError> {
    let input = &detector.manifest.input;
    let boxed = letterbox(resizer, image, input.width, input.height, input.fill)?;
    let shape = [1, input.height as usize, input.width as usize, 3];
    let [rows] = detector.network.run(&boxed.rgb, shape, ["detections"])?;
    if rows.shape.len() != 3 || rows.shape[2] != 6 {
        let problem = format!("has shape {:?}, expected [1, N, 6]", rows.shape);
        return Err(detector.network.output_error("detections", problem).into());
    }
    let image_from_input = boxed.crop_from_image.inverse();
    let mut detections: Vec<Detection> = rows
        .values
        .chunks_exact(6)
        .filter_map(|row| {
            let [x1, y1, x2, y2, score, class] = [0, 1, 2, 3, 4, 5].map(|k| f64::from(row[k]));
            // Edges to pixel centres and back: the affine maps centres.
            let first = image_from_input.apply(&Vector2::new(x1 - 0.5, y1 - 0.5)).add_scalar(0.5);
            let last = image_from_input.apply(&Vector2::new(x2 - 0.5, y2 - 0.5)).add_scalar(0.5);
            let first = Vector2::new(first.x.max(0.0), first.y.max(0.0));
            let last = Vector2::new(last.x.min(f64::from(image.width())), last.y.min(f64::from(image.height())));
            let size = last - first;
            // A class that is no whole number, or no class at all, names no object.
            let object = (0..detector.manifest.labels.len()).find(|k| (class - *k as f64).abs() < 1e-3)?;
            let usable = score >= detector.manifest.score_threshold && size.min() >= 2.0;
            usable.then_some(Detection {
                object,
                bounding_box: BoundingBox { x: first.x, y: first.y, width: size.x, height: size.y },
                score: score.min(1.0),
            })
        })
        .collect();
    detections.sort_by(|a, b| b.score.total_cmp(&a.score));
    detections.truncate(MAX_DETECTIONS);
    Ok(one_per_place(&detections))
}

/// Drops what overlaps a stronger detection almost wholly. The network suppresses such boxes within a class; two classes
/// claiming one place are one object, too.
fn one_per_place(strongest_first: &[Detection]) -> Vec<Detection> {
    let mut kept: Vec<Detection> = Vec::new();
    for detection in strongest_first {
        let taken = kept.iter().any(|k| k.bounding_box.overlap(&detection.bounding_box) > SAME_PLACE_OVERLAP);
        if !taken {
            kept.push(*detection);
        }
    }
    kept
}

fn predict_keypoints(
    model: &mut KeypointModel,
    resizer: &mut Resizer,
    image: &RgbImage,
    boxes: &[BoundingBox],
) -> Result<Vec<KeypointPrediction>, EstimateError> {
    if boxes.is_empty() {
        return Ok(Vec::new());
    }
    let KeypointManifest { crop_scale, crop_ensemble, input, covariance_scale, .. } = &model.manifest;
    let side = input.size as usize;
    let crops: Vec<Resampled> = boxes
        .iter()
        .flat_map(|region| crop_ensemble.iter().map(move |factor| (region, crop_scale * factor)))
        .map(|(region, scale)| crop_square(resizer, image, region, scale, input.size))
        .collect::<Result<_, _>>()?;
    let rgb: Vec<u8> = crops.iter().flat_map(|crop| crop.rgb.iter().copied()).collect();
    let names = ["keypoints", "covariances", "peaks"];
    let outputs = model.network.run(&rgb, [crops.len(), side, side, 3], names)?;
    let count = covariance_scale.len();
    let shapes = [vec![crops.len(), count, 2], vec![crops.len(), count, 2, 2], vec![crops.len(), count]];
    for ((tensor, expected), name) in outputs.iter().zip(&shapes).zip(names) {
        if &tensor.shape != expected {
            let problem = format!("has shape {:?}, expected {expected:?}", tensor.shape);
            return Err(model.network.output_error(name, problem).into());
        }
    }
    let [keypoints, covariances, peaks] = &outputs;
    let of_crops: Vec<KeypointPrediction> = crops
        .iter()
        .enumerate()
        .map(|(row, crop)| {
            let slice = |values: &[f32], width: usize| -> Vec<f64> {
                values[row * count * width..(row + 1) * count * width].iter().map(|v| f64::from(*v)).collect()
            };
            in_image(
                &crop.crop_from_image.inverse(),
                &slice(&keypoints.values, 2),
                &slice(&covariances.values, 4),
                slice(&peaks.values, 1),
                covariance_scale,
            )
        })
        .collect();
    Ok(of_crops.chunks_exact(crop_ensemble.len()).map(average).collect())
}

/// The mean over the crops of one box. Covariances are averaged, not reduced: the crops show the same pixels, and what
/// averaging gains is part of the factors fitted on held-out images.
fn average(of_crops: &[KeypointPrediction]) -> KeypointPrediction {
    let share = (of_crops.len() as f64).recip();
    let mut mean = KeypointPrediction {
        pixels: vec![Vector2::zeros(); of_crops[0].pixels.len()],
        covariances: vec![Matrix2::zeros(); of_crops[0].pixels.len()],
        peaks: vec![0.0; of_crops[0].pixels.len()],
    };
    for crop in of_crops {
        for k in 0..mean.pixels.len() {
            mean.pixels[k] += crop.pixels[k] * share;
            mean.covariances[k] += crop.covariances[k] * share;
            mean.peaks[k] += crop.peaks[k] * share;
        }
    }
    mean
}

/// Maps one crop's keypoints to image pixels, and scales their covariances by what held-out images showed.
fn in_image(
    image_from_crop: &Affine,
    keypoints: &[f64],
    covariances: &[f64],
    peaks: Vec<f64>,
    covariance_scale: &[f64],
) -> KeypointPrediction {
    let pixels = keypoints.chunks_exact(2).map(|uv| image_from_crop.apply(&Vector2::new(uv[0], uv[1]))).collect();
    let covariances = covariances
        .chunks_exact(4)
        .zip(covariance_scale)
        .map(|(c, scale)| image_from_crop.apply_to_covariance(&(Matrix2::from_row_slice(c) * *scale)))
        .collect();
    KeypointPrediction { pixels, covariances, peaks }
}

fn solve_keypoints(
    manifest: &KeypointManifest,
    prediction: &KeypointPrediction,
    camera: &Camera,
    options: &pnp::Options,
) -> Result<Solution, PnpError> {
    pnp::solve(&manifest.keypoints(), &prediction.pixels, &prediction.covariances, camera, options)
}

fn object_pose(
    model: &KeypointModel,
    offset: &Offset,
    detection: Detection,
    prediction: &KeypointPrediction,
    camera: &Camera,
    options: &pnp::Options,
) -> ObjectPose {
    let manifest = &model.manifest;
    let answer = |verdict, pose| ObjectPose {
        object: manifest.name.clone(),
        verdict,
        detection,
        pose,
        diameter_m: manifest.diameter_m,
    };
    let mut verdict = Verdict::default();
    let Ok(solution) = solve_keypoints(manifest, prediction, camera, options) else {
        verdict.object(Reason::NoPose, Status::Rejected);
        return answer(verdict, None);
    };
    verdict = solution.verdict;
    if median(&prediction.peaks) < MIN_MEDIAN_PEAK {
        verdict.object(Reason::WeakKeypoints, Status::LowConfidence);
    }
    if !agrees_with_box(&solution.pose, manifest.diameter_m, &detection.bounding_box, camera) {
        verdict.object(Reason::BoxMismatch, Status::Rejected);
    }
    let reprojection_rmse_px = solution.rmse_px();
    if reprojection_rmse_px > MAX_RMSE * detection.bounding_box.extent() {
        // Wide covariances excuse such residuals, but no pose follows from them.
        verdict.object(Reason::HighResidual, Status::Rejected);
    }
    let in_user_frame = |pose: &Pose, covariance: &Covariance6| {
        let (pose, covariance) = offset.apply(pose, covariance);
        let canonical = model.symmetries.canonical(&pose);
        (canonical, covariance_about(&covariance, &(canonical.translation() - pose.translation())))
    };
    let (camera_from_object, covariance) = in_user_frame(&solution.pose, &solution.covariance);
    if is_loose(&covariance, manifest.diameter_m) {
        verdict.object(Reason::UncertainPose, Status::LowConfidence);
    }
    let alternatives = solution.alternatives.iter().flatten().filter(|a| a.weight > MIN_ALTERNATIVE_WEIGHT);
    let pose = SolvedPose {
        camera_from_object,
        covariance,
        reprojection_rmse_px,
        inliers: solution.inlier_count(),
        keypoints: prediction.pixels.len(),
        alternatives: alternatives.map(|a| (in_user_frame(&a.pose, &a.covariance).0, a.weight)).collect(),
        weight: solution.weight,
    };
    answer(verdict, Some(pose))
}

/// Whether the keypoints' centre lies in the detector's box and the object is as large as the box shows.
fn agrees_with_box(camera_from_keypoints: &Pose, diameter_m: f64, region: &BoundingBox, camera: &Camera) -> bool {
    let centre = camera_from_keypoints.translation();
    camera.project(centre).is_ok_and(|pixel| {
        let shift = (pixel - region.centre()).norm() / region.extent();
        let extent_px = camera.focal().mean() * diameter_m / centre.z;
        shift < MAX_CENTRE_SHIFT && BOX_TO_EXTENT.contains(&(region.extent() / extent_px))
    })
}

/// Whether a robot should not act on a pose with this covariance.
fn is_loose(covariance: &Covariance6, diameter_m: f64) -> bool {
    let sigma = |first: usize| covariance.fixed_view::<3, 3>(first, first).trace().sqrt();
    sigma(0) > MAX_SIGMA_TRANSLATION * diameter_m || sigma(3) > MAX_SIGMA_ROTATION_RAD
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
