//! Whether the poses of a scene's cameras can be meant: where they are, no object is where two views see it.

use posed_core::pnp::Status;
use thiserror::Error;

use super::fuse::fuse;
use super::fused::{FusedPose, PosedCamera};
use crate::estimator::answer::Estimate;
use crate::estimator::mistakes::{MISTAKES, Wrong};
use crate::estimator::verdict::Reason;

/// Poses of cameras that cannot be meant.
#[derive(Debug, Error)]
#[error("by the poses of the cameras no object is where two of the views see it, but the views agree {guess}")]
pub struct CamerasError {
    guess: &'static str,
}

/// Views that have no object in common may show different objects. But if they all agree once the cameras' poses are taken
/// for what people often mean by them, that is what was meant: it does not happen by chance.
///
/// `fused` is what [`fuse`] made of the views.
///
/// # Errors
/// [`CamerasError`] says what was meant.
pub fn cameras_are_meant(
    cameras: &[PosedCamera],
    estimates: &[&Estimate],
    fused: &[FusedPose],
) -> Result<(), CamerasError> {
    if fused.iter().any(|one| used(one) > 1 || one.verdict.reasons.contains(Reason::WeakBaseline)) {
        return Ok(());
    }
    let agree = |cameras: &[PosedCamera]| {
        let fused = fuse(cameras, estimates);
        fused.iter().any(|one| {
            let is_clear = one.verdict.status == Status::Ok && !one.verdict.reasons.contains(Reason::WeakBaseline);
            is_clear && used(one) > 1
        })
    };
    for mistake in MISTAKES {
        let mended = |camera: &PosedCamera| {
            let camera_from_world = (mistake.mended)(&camera.world_from_camera.inverse());
            PosedCamera { world_from_camera: camera_from_world.inverse(), ..*camera }
        };
        if agree(&cameras.iter().map(mended).collect::<Vec<_>>()) {
            return Err(CamerasError { guess: words(mistake.what) });
        }
    }
    Ok(())
}

fn used(fused: &FusedPose) -> usize {
    fused.views.iter().filter(|view| view.left_out.is_none()).count()
}

fn words(mistake: Wrong) -> &'static str {
    match mistake {
        Wrong::Millimetres => "if the translations are in millimetres; give metres",
        Wrong::Inverse => "if the poses are camera_from_world; give their inverses",
        Wrong::InverseInMillimetres => {
            "if the poses are camera_from_world in millimetres; give their inverses, in metres"
        }
        Wrong::OpenGl => {
            "if the cameras look along -z with y up, as in OpenGL; give poses of cameras with z forward and y down"
        }
        Wrong::OpenGlInMillimetres => {
            "if the translations are in millimetres and the cameras look along -z with y up, as in OpenGL; give metres, \
             and poses of cameras with z forward and y down"
        }
    }
}
