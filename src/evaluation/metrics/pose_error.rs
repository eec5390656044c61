use serde::Serialize;

use super::hierarchy::Hierarchy;
use super::model_points::ModelPoints;
use posed_core::geometry::{Camera, Pose};

/// How far one estimate is from the truth. Pixels are infinite where a vertex has no projection, and everything is for a pose
/// that is not finite.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Deviation {
    /// ADD ([`ModelPoints::add_m`]), or ADD-S ([`ModelPoints::add_s_m`]) for an object with symmetries, metres.
    pub add_m: f64,
    /// Mean distance of the vertices' projections, pixels: Brachmann et al. (CVPR 2016), section 4. For an object with symmetries
    /// from the nearest projection of any vertex, of which [`ModelPoints::add_s_m`] says how they are sampled.
    pub projection_px: f64,
    /// MSSD, metres: the largest distance of any vertex, from whichever pose that looks like the true one makes it least. Hodaň et
    /// al., BOP Challenge 2020 (ECCVW 2020), equation 2; a turn about an axis of revolution is made of 315 steps, as in the BOP
    /// toolkit.
    pub mssd_m: f64,
    /// MSPD, pixels: as MSSD, of projections. Ibidem, equation 3.
    pub mspd_px: f64,
    /// Angle from the pose that looks like the true one and is turned least from the estimate, degrees.
    pub rotation_deg: f64,
    /// Distance from the same pose's origin, metres.
    pub translation_m: f64,
}

impl Deviation {
    const INFINITE: Self = Self {
        add_m: f64::INFINITY,
        projection_px: f64::INFINITY,
        mssd_m: f64::INFINITY,
        mspd_px: f64::INFINITY,
        rotation_deg: f64::INFINITY,
        translation_m: f64::INFINITY,
    };

    /// Of an estimate of `camera_from_object`, as is the truth.
    #[must_use]
    pub fn new(points: &ModelPoints, camera: &Camera, estimate: &Pose, truth: &Pose) -> Self {
        if ![estimate, truth].iter().all(|pose| pose.matrix().iter().all(|value| value.is_finite())) {
            return Self::INFINITE;
        }
        let nearest = points.symmetries().nearest(truth, estimate);
        let (projection_px, mspd_px) =
            in_pixels(points, camera, estimate, truth).unwrap_or((f64::INFINITY, f64::INFINITY));
        Self {
            add_m: points.average_distance_m(estimate, truth),
            projection_px,
            mssd_m: mssd_m(points, estimate, truth),
            mspd_px,
            rotation_deg: nearest.angle_to(estimate).to_degrees(),
            translation_m: (nearest.translation() - estimate.translation()).norm(),
        }
    }
}

fn mssd_m(points: &ModelPoints, estimate: &Pose, truth: &Pose) -> f64 {
    let vertices = points.vertices();
    let squared = |equal: &Pose, place: usize| {
        let turned = estimate.rotation().matrix() - equal.rotation().matrix();
        (turned * vertices[place] + (estimate.translation() - equal.translation())).norm_squared()
    };
    points.least_maximum(truth, squared).sqrt()
}

/// Mean distance and MSPD; `None` if a vertex has no projection under the estimate.
fn in_pixels(points: &ModelPoints, camera: &Camera, estimate: &Pose, truth: &Pose) -> Option<(f64, f64)> {
    let vertices = points.vertices();
    let pixel = |pose: &Pose, place: usize| camera.project(&pose.transform(&vertices[place])).ok();
    let estimated: Vec<_> = (0..vertices.len()).map(|place| pixel(estimate, place)).collect::<Option<_>>()?;
    let squared = |equal: &Pose, place: usize| {
        pixel(equal, place).map_or(f64::INFINITY, |pixel| (estimated[place] - pixel).norm_squared())
    };
    let mspd_px = points.least_maximum(truth, squared).sqrt();
    let mean_px = if points.symmetries().is_trivial() {
        (0..vertices.len()).map(|place| squared(truth, place).sqrt()).sum::<f64>() / vertices.len() as f64
    } else {
        let estimated = Hierarchy::new(estimated);
        points.sampled_mean(|place| pixel(truth, place).map_or(f64::INFINITY, |pixel| estimated.distance(&pixel)))
    };
    Some((mean_px, mspd_px))
}
