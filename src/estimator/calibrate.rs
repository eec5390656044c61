use thiserror::Error;

use super::answer::MeasureError;
use super::stated_pose::{StatedPoseError, origin_is_near};
use super::verdict::{Reason, Verdict};
use super::views::{LocatedView, fit_offset_and_scale};
use crate::model::{Method, ObjectModel, PoseFile, Reference, ReferenceView};
use crate::vision::BoundingBox;
use posed_core::calibration::{AverageError, Averaged, Consensus, Mode, Offset, average};
use posed_core::geometry::{Pose, sigmas};
use posed_core::pnp::{Solution, Status};
use posed_core::views::Scale;

/// A reference with fewer agreeing keypoints would spoil every later answer.
const MIN_INLIERS: usize = 5;
/// Nor one whose rotation is looser than this: two modes that have merged look so.
const MAX_SIGMA_ROTATION_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Boxes in one image that overlap by more show the same object (intersection over union).
const SAME_BOX: f64 = 0.5;

/// What one reference image gives.
pub struct MeasuredView {
    /// File name of the image beside the reference: one for each content.
    pub file: String,
    pub region: BoundingBox,
    pub located: LocatedView,
    /// Pose of the virtual keypoints in this image, as large as the network learned them.
    pub solution: Solution,
}

/// A reference, and what else its images show.
pub struct Calibrated {
    pub reference: Reference,
    /// How much larger than its network learned it the images show the object. `None` from fewer than three, or if all
    /// look from nearly one direction.
    pub scale: Option<Scale>,
}

/// References that no offset follows from.
#[derive(Debug, Error)]
pub enum CalibrateError {
    #[error("{file}: {source}")]
    Measure { view: usize, file: String, source: MeasureError },
    #[error(transparent)]
    Average(#[from] AverageError),
    #[error(transparent)]
    StatedPose(#[from] StatedPoseError),
    #[error(
        "a scale of the keypoints needs at least three references that agree, from sides that are 20 degrees or more apart; \
         of these {references}, {agreeing} agree"
    )]
    NoScale { agreeing: usize, references: usize },
}

/// What the coordinates of the virtual keypoints are multiplied by before a pose is solved from them.
#[derive(Clone, Copy, Debug)]
pub enum KeypointsScale {
    Stays(f64),
    /// As the references show it: they must say so, see [`Calibrated::scale`].
    Fitted,
}

/// How the offset follows from the views.
#[derive(Clone, Copy, Debug)]
pub struct CalibrateOptions {
    pub mode: Mode,
    /// Whether the origin of the object's frame may lie farther from the object than the object is large.
    pub far_origin: bool,
    pub scale: KeypointsScale,
}

/// The offset of an object from what its reference images give.
///
/// # Errors
/// When an image is too weak, the images contradict each other or say nothing of the scale that is asked for, or their
/// stated poses cannot be meant.
pub fn calibrate(
    model: &ObjectModel,
    views: Vec<MeasuredView>,
    options: CalibrateOptions,
) -> Result<Calibrated, CalibrateError> {
    let first = match options.scale {
        KeypointsScale::Stays(scale) => scale,
        KeypointsScale::Fitted => 1.0,
    };
    let averaged = offset_of(model, &views, first, options)?;
    no_image_twice(&views, model.manifest.diameter_m)?;
    let located: Vec<&LocatedView> = views.iter().map(|view| &view.located).collect();
    let of_scale = |scale| offset_of(model, &views, scale, options).ok();
    let fitted = fit_offset_and_scale(model, &located, &averaged, of_scale);
    let (averaged, scale) = match (options.scale, fitted) {
        (KeypointsScale::Fitted, Some((fitted, scale))) => (fitted, Some(scale)),
        (KeypointsScale::Fitted, None) => {
            let agreeing = averaged.residuals.iter().filter(|residual| residual.inlier).count();
            return Err(CalibrateError::NoScale { agreeing, references: views.len() });
        }
        (KeypointsScale::Stays(_), fitted) => (averaged, fitted.map(|(_, scale)| scale)),
    };
    let method = Method::of(views.len(), options.mode);
    let views = views.into_iter().zip(&averaged.residuals).map(|(view, residual)| ReferenceView {
        image: view.file,
        camera: view.located.camera,
        camera_from_object: PoseFile::from(&view.located.camera_from_object),
        box_px: view.region.into(),
        inlier: residual.inlier,
        residual_deg: residual.rotation_rad.to_degrees(),
        residual_mm: 1e3 * residual.translation_m,
    });
    let reference = Reference {
        object: model.manifest.name.clone(),
        keypoint_model_sha256: model.manifest.model_sha256.clone(),
        method,
        views: views.collect(),
        offset: averaged.offset,
    };
    Ok(Calibrated { reference, scale })
}

/// What the views say together, with keypoints of this scale.
fn offset_of(
    model: &ObjectModel,
    views: &[MeasuredView],
    keypoints_scale: f64,
    CalibrateOptions { mode, far_origin, .. }: CalibrateOptions,
) -> Result<Averaged, CalibrateError> {
    let measured = |(index, view): (usize, &MeasuredView)| {
        let offset = measure_offset(&view.located.camera_from_object, &view.solution, keypoints_scale);
        offset.map_err(|source| CalibrateError::Measure { view: index, file: view.file.clone(), source })
    };
    let offsets = views.iter().enumerate().map(measured).collect::<Result<Vec<_>, _>>()?;
    let meant = |(view, offset): (&MeasuredView, &Offset)| {
        let seen = view.solution.pose.scaled(keypoints_scale);
        origin_is_near(offset, &view.located.camera_from_object, &seen, model.manifest.diameter_m)
    };
    let averaged = average_offsets(model, offsets.clone(), mode);
    if averaged.is_err() && !far_origin {
        // A mistake that all poses have in common keeps them from agreeing.
        let far: Vec<_> = views.iter().zip(&offsets).filter_map(|one| meant(one).err()).collect();
        let is_common = far.len() == views.len();
        if let Some(first) = far.into_iter().next().filter(|_| is_common) {
            return Err(first.into());
        }
    }
    let averaged = averaged?;
    let agreeing = views.iter().zip(&averaged.residuals).find(|(_, residual)| residual.inlier);
    if let Some((view, _)) = agreeing.filter(|_| !far_origin) {
        meant((view, &averaged.offset))?;
    }
    Ok(averaged)
}

/// Several copies of an object in one image have boxes of their own, and are not within each other.
fn no_image_twice(views: &[MeasuredView], diameter_m: f64) -> Result<(), StatedPoseError> {
    for (index, view) in views.iter().enumerate() {
        let apart_m = |other: &MeasuredView| {
            let place = |view: &MeasuredView| *view.located.camera_from_object.translation();
            (place(other) - place(view)).norm()
        };
        let same = |other: &&MeasuredView| {
            let in_one_place = || apart_m(other) < diameter_m / 4.0;
            other.file == view.file && (other.region.overlap(&view.region) > SAME_BOX || in_one_place())
        };
        if let Some(first) = views[..index].iter().position(|other| same(&other)) {
            return Err(StatedPoseError::SameImage { first, second: index, box_px: view.region.into() });
        }
    }
    Ok(())
}

/// The offset that one reference image gives, where its object's pose is known, with keypoints of some scale. `solution` is
/// of the keypoints as the network learned them.
///
/// # Errors
/// When the solution is too weak to rest every later answer on.
pub fn measure_offset(
    camera_from_object: &Pose,
    solution: &Solution,
    keypoints_scale: f64,
) -> Result<Offset, MeasureError> {
    let (agreeing, keypoints) = (solution.inlier_count(), solution.residuals().len());
    if agreeing < MIN_INLIERS {
        return Err(MeasureError::FewInliers { agreeing, keypoints });
    }
    let mut verdict = Verdict::of(solution);
    if sigmas(&solution.covariance).1 > MAX_SIGMA_ROTATION_RAD {
        verdict.object(Reason::UncertainPose, Status::LowConfidence);
    }
    if verdict.status != Status::Ok {
        let reasons = verdict.reasons.iter().map(|reason| reason.to_string()).collect::<Vec<_>>().join(", ");
        return Err(MeasureError::Doubtful { reasons });
    }
    // What is seen alike of a larger object is the same pose farther away.
    let offset = Offset::measure(camera_from_object, &solution.pose.scaled(keypoints_scale), &solution.covariance);
    Ok(offset.of_keypoints_scaled_by(keypoints_scale))
}

/// One offset from those of several reference images.
///
/// # Errors
/// When the images contradict each other.
pub fn average_offsets(model: &ObjectModel, mut offsets: Vec<Offset>, mode: Mode) -> Result<Averaged, AverageError> {
    // The best known one says which of the orientations that look alike is meant.
    if let Some(best) = offsets.iter().min_by(|a, b| a.sigmas().1.total_cmp(&b.sigmas().1)).cloned() {
        for offset in &mut offsets {
            *offset = offset.nearest(&model.symmetries, &best);
        }
    }
    average(&offsets, mode, &Consensus::default())
}
