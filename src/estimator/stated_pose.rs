//! Whether the poses that come with reference images can be meant: where the image shows the object, its frame should lie.

use posed_core::calibration::Offset;
use posed_core::geometry::Pose;
use thiserror::Error;

use super::mistakes::{MISTAKES, Wrong};

/// Poses of reference images that cannot be meant.
#[derive(Debug, Error)]
pub enum StatedPoseError {
    #[error(
        "{first} and {second} have the same pose; give each view once, since a second copy adds no information. Best are \
         views from other sides"
    )]
    SameView { first: String, second: String },
    #[error(
        "references {first} and {second}, counted from 0, are the same object in the same image (box {box_px:?}); give each \
         image once, since a second copy adds no information. Best are views from other sides"
    )]
    SameImage { first: usize, second: usize, box_px: [f64; 4] },
    #[error(
        "by the stated pose the origin of the object's frame is {distance_m:.3} m from where the image shows the object, \
         which is {diameter_m:.3} m large: {guess}. If the origin is that far away, set 'far_origin' (--far-origin)"
    )]
    FarOrigin { distance_m: f64, diameter_m: f64, guess: &'static str },
}

/// Farthest origin of a frame from the object's centre that passes without a word, in diameters: those on the object's
/// surface are at most half as far.
const FAR: f64 = 1.0;
/// Two views whose stated poses differ by less are one: nobody puts an object back so well.
const SAME_PLACE_M: f64 = 1e-4;
const SAME_TURN_RAD: f64 = 1e-4;

/// One view twice would count as two measurements, and its error as half as large.
///
/// `views` are names of images and the poses `camera_from_object` that are stated for them.
///
/// # Errors
/// [`StatedPoseError::SameView`] names the two.
pub fn no_view_twice(views: &[(String, Pose)]) -> Result<(), StatedPoseError> {
    for (index, (second, pose)) in views.iter().enumerate() {
        let same = |(_, other): &&(String, Pose)| {
            let change = other.inverse() * *pose;
            change.translation().norm() < SAME_PLACE_M && change.rotation().angle() < SAME_TURN_RAD
        };
        if let Some((first, _)) = views[..index].iter().find(same) {
            return Err(StatedPoseError::SameView { first: first.clone(), second: second.clone() });
        }
    }
    Ok(())
}

/// An origin far from where the images show the object is a mistake in the poses more often than it is meant.
/// The guess what the mistake is comes from one image: its stated pose and that of its keypoints.
pub(super) fn origin_is_near(
    offset: &Offset,
    camera_from_object: &Pose,
    camera_from_keypoints: &Pose,
    diameter_m: f64,
) -> Result<(), StatedPoseError> {
    let distance_m = offset.object_from_keypoints.translation().norm();
    if distance_m <= FAR * diameter_m {
        return Ok(());
    }
    let near = |camera_from_object: &Pose| {
        let object_from_keypoints = camera_from_object.inverse() * *camera_from_keypoints;
        object_from_keypoints.translation().norm() <= FAR * diameter_m
    };
    let guess = MISTAKES.iter().find(|mistake| near(&(mistake.mended)(camera_from_object)));
    let guess = guess.map_or("the pose may be that of another object or image", |mistake| words(mistake.what));
    Err(StatedPoseError::FarOrigin { distance_m, diameter_m, guess })
}

fn words(mistake: Wrong) -> &'static str {
    match mistake {
        Wrong::Millimetres => "the pose fits if its translation is in millimetres; give metres",
        Wrong::Inverse => "the pose fits if it is object_from_camera; give its inverse",
        Wrong::InverseInMillimetres => {
            "the pose fits if it is object_from_camera in millimetres; give its inverse, in metres"
        }
        Wrong::OpenGl => {
            "the pose fits if its camera looks along -z with y up, as in OpenGL; give one with z forward and y down"
        }
        Wrong::OpenGlInMillimetres => {
            "the pose fits if its translation is in millimetres and its camera looks along -z with y up, as in OpenGL; \
             give metres, z forward and y down"
        }
    }
}
