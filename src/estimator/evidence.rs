//! What speaks for and against a pose, gathered from all stages, and what its model makes of it.

use image::RgbImage;
use nalgebra::{Matrix3, Vector3};
use posed_core::geometry::{Camera, Covariance6};
use posed_core::pnp::Solution;
use posed_core::views::{Mode, Reading};

use super::answer::{Detection, KeypointPrediction, Observed};
use crate::model::{Evidence, KeypointManifest};
use crate::vision::BoundingBox;

/// Logarithms are taken of no less.
const LEAST: f64 = 1e-4;
/// Pixels of a box that are looked at, in each direction.
const SAMPLES: u32 = 64;
/// A box that ends so near the image's border is cut off by it, pixels.
const BORDER_PX: f64 = 2.0;

/// By how much the solver's standard deviations are too small where no trust says it: the errors of a crop's keypoints are no
/// independent ones. Measured on rendered images.
const UNJUDGED: [f64; 3] = [1.7; 3];

/// What becomes of a pose in the light of its evidence.
pub(super) struct Judgement {
    pub evidence: Evidence,
    /// That the pose is right, 0..1. `None` where the model does not state what evidence is worth.
    pub probability: Option<f64>,
    /// Factors of the solver's standard deviations, where the model states any.
    factors: Option<[f64; 3]>,
}

/// The evidence for a pose that was solved within a detection's box, and what the model makes of it.
pub(super) fn judge(
    manifest: &KeypointManifest,
    detection: &Detection,
    prediction: &KeypointPrediction,
    solution: &Solution,
    image: &RgbImage,
    camera: &Camera,
) -> Judgement {
    let evidence = gather(manifest.diameter_m, detection, prediction, solution, image, camera);
    let trust = manifest.trust.as_ref();
    let probability = trust.and_then(|trust| trust.probability(&evidence));
    Judgement { evidence, probability, factors: trust.map(|trust| trust.factors(&evidence)) }
}

impl Judgement {
    /// An honest covariance of the pose, as far as it is known: the solver's own where the model does not state what evidence is
    /// worth.
    pub(super) fn covariance(&self, solution: &Solution) -> Covariance6 {
        let own = &solution.covariance;
        self.factors.map_or(*own, |factors| scaled_covariance(own, solution.pose.translation(), factors))
    }

    /// What an image says, for fusing it with others. The solution has its covariance from the solver.
    pub(super) fn observed(&self, solution: &Solution, readings: Vec<Reading>) -> Observed {
        let known = self.factors.unwrap_or(UNJUDGED);
        // The few views that tell no probability cannot tell, either, that the points of an image share nothing.
        let few = self.probability.is_none();
        let factors = std::array::from_fn(|k| if few { known[k].max(UNJUDGED[k]) } else { known[k] });
        observed(solution, readings, factors)
    }
}

/// As [`Judgement::observed`], where nothing is known but the solution.
pub(super) fn unjudged(solution: &Solution, readings: Vec<Reading>) -> Observed {
    observed(solution, readings, UNJUDGED)
}

fn observed(solution: &Solution, readings: Vec<Reading>, factors: [f64; 3]) -> Observed {
    let honest = |(place, mode): (usize, Mode)| {
        let covariance = scaled_covariance(&mode.covariance, mode.camera_from_points.translation(), factors);
        // A second reading is that of the first alternative.
        let reading = usize::from(place == 1 && readings.len() > 1);
        Mode { reading, ..mode.with_covariance(&covariance) }
    };
    let modes = Mode::all_of(solution).into_iter().enumerate().map(honest).collect();
    Observed { readings, modes }
}

fn gather(
    diameter_m: f64,
    detection: &Detection,
    prediction: &KeypointPrediction,
    solution: &Solution,
    image: &RgbImage,
    camera: &Camera,
) -> Evidence {
    let region = &detection.bounding_box;
    let centre = solution.pose.translation();
    let (shift, _) = in_box(centre, diameter_m, region, camera).unwrap_or((1.0, 1.0));
    let extent_px = extent_px(centre, diameter_m, camera);
    let peaks = sorted(&prediction.peaks);
    let second = prediction.second.as_ref().map(|second| sorted(&second.weights));
    let points = solution.residuals().len().max(1) as f64;
    let spread = &prediction.spread;
    let [depth, lateral, rotation] = spreads(&solution.covariance, centre);
    let pixels = Pixels::of(image, region);
    Evidence {
        size: ln(extent_px / 100.0),
        crops_apart: spread.apart.map_or(f64::NAN, ln),
        crops_scale: spread.scale.map_or(f64::NAN, ln),
        crops_left_out: spread.left_out,
        look_moved: spread.moved.map_or(f64::NAN, ln),
        peak: middle(&peaks),
        least_peak: peaks.first().copied().unwrap_or(0.0),
        second_peak: second.map_or(f64::NAN, |weights| middle(&weights)),
        unfamiliarity: prediction.unfamiliarity.map_or(f64::NAN, ln),
        residual: ln(solution.chi2 / (solution.degrees_of_freedom.max(1) as f64)),
        outliers: 1.0 - solution.inlier_count() as f64 / points,
        rivals: 1.0 - solution.weight,
        // A box that the caller gave has none.
        score: if detection.given.is_some() { f64::NAN } else { detection.score },
        box_size: ln(region.extent() / extent_px),
        box_shift: shift.min(1.0),
        at_border: f64::from(u8::from(touches_border(region, image))),
        sigma_depth: ln(depth / diameter_m),
        sigma_lateral: ln(lateral / diameter_m),
        sigma_rotation: ln(rotation),
        brightness: pixels.brightness,
        contrast: pixels.contrast,
        saturation: pixels.saturation,
        warmth: pixels.warmth,
        greenness: pixels.greenness,
        sharpness: ln(pixels.step / pixels.contrast.max(LEAST)),
    }
}

/// How far the centre of a pose lies from that of a box, in larger box sides, and how much larger the box is than the object's
/// extent there. `None` where the camera does not see the centre.
pub(super) fn in_box(
    centre: &Vector3<f64>,
    diameter_m: f64,
    region: &BoundingBox,
    camera: &Camera,
) -> Option<(f64, f64)> {
    let pixel = camera.project(centre).ok()?;
    let shift = (pixel - region.centre()).norm() / region.extent();
    Some((shift, region.extent() / extent_px(centre, diameter_m, camera)))
}

fn extent_px(centre: &Vector3<f64>, diameter_m: f64, camera: &Camera) -> f64 {
    camera.focal().mean() * diameter_m / centre.z
}

/// A pose's covariance with its standard deviations along the ray to it, across it, and of the rotation multiplied by factors.
fn scaled_covariance(
    covariance: &Covariance6,
    place: &Vector3<f64>,
    [depth, lateral, rotation]: [f64; 3],
) -> Covariance6 {
    let ray = place.normalize();
    let along = ray * ray.transpose();
    let mut factors = Covariance6::identity() * rotation;
    factors.fixed_view_mut::<3, 3>(0, 0).copy_from(&(along * depth + (Matrix3::identity() - along) * lateral));
    factors * covariance * factors
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// The median of what is sorted.
fn middle(sorted: &[f64]) -> f64 {
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

fn ln(value: f64) -> f64 {
    value.max(LEAST).ln()
}

/// Standard deviations along the ray to `place` and across it (metres), and of the rotation (radians).
fn spreads(covariance: &Covariance6, place: &Vector3<f64>) -> [f64; 3] {
    let ray = place.normalize();
    let translation = covariance.fixed_view::<3, 3>(0, 0);
    let along = ray.dot(&(translation * ray));
    let rotation = covariance.fixed_view::<3, 3>(3, 3).trace();
    [along, (translation.trace() - along).max(0.0), rotation].map(f64::sqrt)
}

fn touches_border(region: &BoundingBox, image: &RgbImage) -> bool {
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    region.x.min(region.y) < BORDER_PX
        || width - region.x - region.width < BORDER_PX
        || height - region.y - region.height < BORDER_PX
}

/// How the pixels of a box look.
#[derive(Default)]
struct Pixels {
    brightness: f64,
    contrast: f64,
    saturation: f64,
    warmth: f64,
    greenness: f64,
    /// Mean difference of brightness from the next pixel.
    step: f64,
}

impl Pixels {
    /// Of a grid of pixels in a box; the part of a box outside the image does not count.
    fn of(image: &RgbImage, region: &BoundingBox) -> Self {
        let columns = grid(region.x, region.width, image.width());
        let rows = grid(region.y, region.height, image.height());
        let (mut sum, mut squares, mut count) = (Self::default(), 0.0, 0.0);
        for y in rows {
            for x in columns.clone() {
                let [red, green, blue] = image.get_pixel(x, y).0.map(|channel| f64::from(channel) / 255.0);
                let brightness = (red + green + blue) / 3.0;
                let next =
                    image.get_pixel((x + 1).min(image.width() - 1), y).0.map(|channel| f64::from(channel) / 255.0);
                sum.brightness += brightness;
                squares += brightness * brightness;
                sum.saturation += red.max(green).max(blue) - red.min(green).min(blue);
                sum.warmth += red - blue;
                sum.greenness += green - f64::midpoint(red, blue);
                sum.step += (next.iter().sum::<f64>() / 3.0 - brightness).abs();
                count += 1.0;
            }
        }
        if count == 0.0 {
            return Self::default();
        }
        let mean = sum.brightness / count;
        Self {
            brightness: mean,
            contrast: (squares / count - mean * mean).max(0.0).sqrt(),
            saturation: sum.saturation / count,
            warmth: sum.warmth / count,
            greenness: sum.greenness / count,
            step: sum.step / count,
        }
    }
}

/// Up to [`SAMPLES`] pixels between two places of an image's side.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
fn grid(from: f64, length: f64, side: u32) -> std::iter::StepBy<std::ops::Range<u32>> {
    let clamped = |place: f64| place.clamp(0.0, side.into()) as u32;
    let (first, end) = (clamped(from), clamped(from + length));
    (first..end).step_by(((end - first).div_ceil(SAMPLES)).max(1) as usize)
}
