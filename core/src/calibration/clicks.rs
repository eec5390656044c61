//! The known pose of a reference image without any measuring device: two images with a known relative pose, and a few
//! points clicked in both (paper, appendix "Getting the reference image").

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
use thiserror::Error;

use crate::geometry::{Camera, Covariance6, Observation, Pose, TriangulationError, triangulate};
use crate::pnp::{self, MAX_POINTS, MIN_POINTS, PnpError};

/// One point of the object, in pixels of both images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Click {
    /// Where it is in the first image.
    pub first_px: Vector2<f64>,
    /// Where it is in the second image.
    pub second_px: Vector2<f64>,
}

/// Two images of one still object.
#[derive(Clone, Debug)]
pub struct ClickedPair<'a> {
    /// Of the first image.
    pub first_camera: &'a Camera,
    /// Of the second image.
    pub second_camera: &'a Camera,
    /// Relative pose of the cameras, metres.
    pub second_from_first: Pose,
    /// 4 to 16 points.
    pub clicks: &'a [Click],
    /// Standard deviation of a click, pixels.
    pub sigma_px: f64,
}

/// The user's frame, by the indices of three clicks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameClicks {
    /// Where the frame's origin is.
    pub origin: usize,
    /// A point on its positive x axis.
    pub on_x: usize,
    /// A point of its xy plane, on the side of positive y.
    pub in_xy: usize,
}

/// A reference pose and what speaks for it.
#[derive(Clone, Debug)]
pub struct ClickedReference {
    /// Pose of the user's frame in the first image.
    pub camera_from_object: Pose,
    /// Covariance of the pose, from the clicks' errors in the first image.
    pub covariance: Covariance6,
    /// The clicked points, metres, in the user's frame.
    pub points_in_object: Vec<Vector3<f64>>,
    /// One for each click.
    pub residuals: Vec<ClickResidual>,
}

/// How well a click fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClickResidual {
    /// Reprojection error of the triangulated point in each image.
    pub first_px: f64,
    /// The same in the second image.
    pub second_px: f64,
    /// Distance of the triangulated point from the further of its two rays, millimetres.
    pub ray_mm: f64,
    /// Standard deviation of the triangulated point, millimetres.
    pub sigma_mm: f64,
}

/// Clicks that no reference pose follows from.
#[allow(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ClickError {
    #[error("{0} clicked points; give {MIN_POINTS} to {MAX_POINTS}")]
    Count(usize),
    #[error("the standard deviation of a click is {0}; it must be a positive number of pixels")]
    Sigma(f64),
    #[error("click {index}: {source}")]
    Triangulation { index: usize, source: TriangulationError },
    #[error(
        "click {index}: its two rays miss each other by {error_px:.0} px; check the click, the relative pose (which way \
         it goes, and its unit) and the cameras"
    )]
    RaysMiss { index: usize, error_px: f64 },
    #[error(
        "click {index}: its two rays miss each other by {error_px:.1} px, those of the others by {others_px:.1} px (median); \
         click it again, or leave it out"
    )]
    Outlier { index: usize, error_px: f64, others_px: f64 },
    #[error(
        "every click is at the same place in both images, within {SAME_IMAGE_SIGMAS} sigma: they seem to be one image; choose a \
         second one from another side"
    )]
    SameImage,
    #[error("the frame refers to click {index}, but there are only {clicks}, counted from 0")]
    FrameIndex { index: usize, clicks: usize },
    #[error(
        "the three points that span the frame lie within {:.0} degrees of one line; choose three that form a wide triangle",
        MIN_FRAME_ANGLE_RAD.to_degrees()
    )]
    DegenerateFrame,
    #[error(transparent)]
    Pnp(#[from] PnpError),
    #[error(
        "the pose of the points in the first image is {angle_deg:.0} degrees from where triangulation puts them; \
         check the relative pose and the order of the clicks"
    )]
    Contradiction { angle_deg: f64 },
}

/// A click further from its epipolar line than this many standard deviations is no slip of the hand.
const MAX_ERROR_SIGMAS: f64 = 10.0;
/// A click this many standard deviations off is looked at ...
const OUTLIER_SIGMAS: f64 = 3.0;
/// ... and wrong if it is off by so many times as much as the others ...
const OUTLIER_TIMES: f64 = 5.0;
/// ... of which so many are right for each one that is wrong. Where more are off, something else is wrong.
const RIGHT_FOR_EACH_WRONG: usize = 3;
/// All points of an object are nowhere near the same pixels of two images of it.
const SAME_IMAGE_SIGMAS: f64 = 3.0;
const MIN_FRAME_ANGLE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// The pose may be this far from the triangulated frame.
const MAX_DISAGREEMENT_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// The pose of the user's frame in the first image.
///
/// # Errors
/// [`ClickError`] names the click or says what contradicts what.
pub fn reference_from_clicks(pair: &ClickedPair, frame: FrameClicks) -> Result<ClickedReference, ClickError> {
    if !(MIN_POINTS..=MAX_POINTS).contains(&pair.clicks.len()) {
        return Err(ClickError::Count(pair.clicks.len()));
    }
    if !(pair.sigma_px > 0.0 && pair.sigma_px < f64::INFINITY) {
        return Err(ClickError::Sigma(pair.sigma_px));
    }
    let same = |click: &Click| (click.first_px - click.second_px).norm() <= SAME_IMAGE_SIGMAS * pair.sigma_px;
    if pair.clicks.iter().all(same) {
        return Err(ClickError::SameImage);
    }
    let mut points_in_first = Vec::with_capacity(pair.clicks.len());
    let mut residuals = Vec::with_capacity(pair.clicks.len());
    for (index, click) in pair.clicks.iter().enumerate() {
        let (point, residual) =
            pair.triangulate(click).map_err(|source| ClickError::Triangulation { index, source })?;
        points_in_first.push(point);
        residuals.push(residual);
    }
    check_residuals(&residuals, pair.sigma_px)?;
    let first_from_frame = frame.build(&points_in_first)?;
    let frame_from_first = first_from_frame.inverse();
    let points_in_object: Vec<_> = points_in_first.iter().map(|point| frame_from_first.transform(point)).collect();
    let pixels: Vec<_> = pair.clicks.iter().map(|click| click.first_px).collect();
    let covariances = vec![pair.covariance(); pixels.len()];
    let options = pnp::Options { floor_px: 0.0, previous: Some(first_from_frame), ..pnp::Options::default() };
    let solution = pnp::solve(&points_in_object, &pixels, &covariances, pair.first_camera, &options)?;
    // One image of a few flat points may have two poses; the second image tells which.
    let modes = std::iter::once((solution.pose, solution.covariance))
        .chain(solution.alternatives.iter().flatten().map(|other| (other.pose, other.covariance)));
    let (camera_from_object, covariance) = modes
        .min_by(|a, b| a.0.angle_to(&first_from_frame).total_cmp(&b.0.angle_to(&first_from_frame)))
        .ok_or(PnpError::NoPose)?;
    let angle = camera_from_object.angle_to(&first_from_frame);
    if angle > MAX_DISAGREEMENT_RAD {
        return Err(ClickError::Contradiction { angle_deg: angle.to_degrees() });
    }
    Ok(ClickedReference { camera_from_object, covariance, points_in_object, residuals })
}

/// Few clicks that are off are slips of the hand; where many are, the cameras or their pose are wrong.
fn check_residuals(residuals: &[ClickResidual], sigma_px: f64) -> Result<(), ClickError> {
    let errors: Vec<f64> = residuals.iter().map(|residual| residual.first_px.max(residual.second_px)).collect();
    let is_outlier = |index: usize| {
        let others_px = median_without(&errors, index);
        errors[index] > (OUTLIER_SIGMAS * sigma_px).max(OUTLIER_TIMES * others_px)
    };
    let outliers: Vec<usize> = (0..errors.len()).filter(|index| is_outlier(*index)).collect();
    if let Some(worst) = outliers.iter().copied().max_by(|a, b| errors[*a].total_cmp(&errors[*b]))
        && errors.len() >= outliers.len() * (1 + RIGHT_FOR_EACH_WRONG)
    {
        let others_px = median_without(&errors, worst);
        return Err(ClickError::Outlier { index: worst, error_px: errors[worst], others_px });
    }
    match errors.iter().position(|error_px| *error_px > MAX_ERROR_SIGMAS * sigma_px) {
        Some(index) => Err(ClickError::RaysMiss { index, error_px: errors[index] }),
        None => Ok(()),
    }
}

/// The median of all values but one.
fn median_without(values: &[f64], index: usize) -> f64 {
    let mut others: Vec<f64> = values[..index].iter().chain(&values[index + 1..]).copied().collect();
    others.sort_by(f64::total_cmp);
    others.get(others.len() / 2).copied().unwrap_or(0.0)
}

impl ClickedPair<'_> {
    fn covariance(&self) -> Matrix2<f64> {
        Matrix2::identity() * (self.sigma_px * self.sigma_px)
    }

    /// The clicked point in the frame of the first camera.
    fn triangulate(&self, click: &Click) -> Result<(Vector3<f64>, ClickResidual), TriangulationError> {
        let observation = |camera, camera_from_world, pixel| Observation {
            camera,
            camera_from_world,
            pixel,
            covariance_px: self.covariance(),
        };
        let observations = [
            observation(self.first_camera, Pose::identity(), click.first_px),
            observation(self.second_camera, self.second_from_first, click.second_px),
        ];
        let found = triangulate(&observations)?;
        let mut errors_px = [0.0; 2];
        let mut ray_mm = 0.0_f64;
        for (index, (error_px, seen)) in errors_px.iter_mut().zip(&observations).enumerate() {
            let in_camera = seen.camera_from_world.transform(&found.point_in_world);
            let at = |source| TriangulationError::Pixel { index, source };
            *error_px = (seen.camera.project(&in_camera).map_err(at)? - seen.pixel).norm();
            let ray = seen.camera.unproject(&seen.pixel).map_err(at)?.push(1.0).normalize();
            ray_mm = ray_mm.max(1e3 * in_camera.cross(&ray).norm());
        }
        let sigma_mm = 1e3 * found.covariance.trace().sqrt();
        let [first_px, second_px] = errors_px;
        Ok((found.point_in_world, ClickResidual { first_px, second_px, ray_mm, sigma_mm }))
    }
}

impl FrameClicks {
    /// The pose of the frame in the frame of the points.
    fn build(&self, points: &[Vector3<f64>]) -> Result<Pose, ClickError> {
        let point =
            |index: usize| points.get(index).copied().ok_or(ClickError::FrameIndex { index, clicks: points.len() });
        let (origin, on_x, in_xy) = (point(self.origin)?, point(self.on_x)?, point(self.in_xy)?);
        let direction = |to: Vector3<f64>| (to - origin).try_normalize(1e-9).ok_or(ClickError::DegenerateFrame);
        let x = direction(on_x)?;
        let z =
            x.cross(&direction(in_xy)?).try_normalize(MIN_FRAME_ANGLE_RAD.sin()).ok_or(ClickError::DegenerateFrame)?;
        let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
        Ok(Pose::new(Rotation3::from_matrix_unchecked(axes), origin))
    }
}
