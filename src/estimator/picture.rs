use image::RgbImage;

use super::answer::{Estimate, ObjectPose};
use crate::vision::{Mark, PoseMark, draw_marks, status_colour};
use posed_core::pnp::Status;

impl Estimate {
    /// Draws what was found into the image it was found in: boxes in the colour of the status, axes, labels.
    pub fn draw(&self, image: &mut RgbImage) {
        let marks: Vec<Mark> = self.poses.iter().map(mark).collect();
        draw_marks(image, &self.camera, &marks);
    }
}

fn mark(found: &ObjectPose) -> Mark {
    let suffix = match found.verdict.status {
        Status::Ok => "",
        Status::Ambiguous => " ambiguous",
        Status::LowConfidence => " low",
        Status::Rejected => " rejected",
    };
    let colour = status_colour(found.verdict.status);
    let pose = found.pose.as_ref().map(|solved| PoseMark {
        camera_from_object: solved.camera_from_object,
        axis_length_m: 0.5 * found.diameter_m,
        corners: solved.box_in_camera,
    });
    Mark { bounding_box: found.detection.bounding_box, colour, label: format!("{}{suffix}", found.object), pose }
}
