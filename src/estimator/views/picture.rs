//! A picture of all views side by side.

use image::RgbImage;
use image::imageops::{self, FilterType};
use posed_core::geometry::Pose;
use posed_core::pnp::Status;

use super::fused::{FusedPose, LeftOut};
use crate::estimator::answer::Estimate;
use crate::vision::{BoundingBox, Mark, PoseMark, draw_marks, status_colour};

/// Height of the picture, at most that of the lowest view: pixels.
const HEIGHT: u32 = 480;
/// A view is no wider than so many times its height.
const MAX_ASPECT: u32 = 4;
const GREY: [u8; 3] = [150, 150, 150];

/// One view as it is drawn: small, so that many of them find room.
#[derive(Debug)]
pub struct ViewsPicture {
    image: RgbImage,
    scale: [f64; 2],
}

impl ViewsPicture {
    /// Shrinks a view's image.
    #[must_use]
    pub fn of(image: &RgbImage) -> Self {
        let (width, height) = image.dimensions();
        let to_height = HEIGHT.min(height);
        let to_width = u32::try_from(u64::from(width) * u64::from(to_height) / u64::from(height)).unwrap_or(u32::MAX);
        let to_width = to_width.clamp(1, MAX_ASPECT * to_height);
        let scale = [f64::from(to_width) / f64::from(width), f64::from(to_height) / f64::from(height)];
        let small = if (to_width, to_height) == (width, height) {
            image.clone()
        } else {
            imageops::resize(image, to_width, to_height, FilterType::Triangle)
        };
        Self { image: small, scale }
    }

    /// The memory that it takes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.image.as_raw().len() as u64
    }

    /// Draws the fused poses of the objects that a view shows; those that do not rest on it in grey.
    #[must_use]
    pub fn drawn(mut self, view: usize, estimate: &Estimate, fused: &[FusedPose]) -> RgbImage {
        let (width, height) = self.image.dimensions();
        // A camera without a size is that of the whole image.
        let camera = estimate.camera.clone().with_size(estimate.width, estimate.height);
        let camera = camera.and_then(|camera| camera.for_resized(width, height));
        let camera = camera.unwrap_or_else(|_| estimate.camera.clone());
        let marks: Vec<Mark> = fused.iter().filter_map(|object| self.mark(view, estimate, object)).collect();
        draw_marks(&mut self.image, &camera, &marks);
        self.image
    }

    fn mark(&self, view: usize, estimate: &Estimate, object: &FusedPose) -> Option<Mark> {
        let share = object.views.iter().find(|share| share.view == view)?;
        let own = estimate.poses.get(share.place)?;
        let suffix = match (share.left_out, object.verdict.status) {
            (Some(LeftOut::Contradicts), _) => " contradicts",
            (Some(LeftOut::Rejected), _) | (None, Status::Rejected) => " rejected",
            (Some(LeftOut::NoBaseline), _) => " no baseline",
            (None, Status::Ok) => "",
            (None, Status::Ambiguous) => " ambiguous",
            (None, Status::LowConfidence) => " low",
        };
        let colour = if share.left_out.is_some() { GREY } else { status_colour(object.verdict.status) };
        let pose = share.camera_from_object.zip(own.pose.as_ref()).map(|(pose, own)| {
            let motion: Pose = pose * own.camera_from_object.inverse();
            PoseMark {
                camera_from_object: pose,
                axis_length_m: 0.5 * object.diameter_m,
                corners: own.box_in_camera.map(|corner| motion.transform(&corner)),
            }
        });
        let BoundingBox { x, y, width, height } = own.detection.bounding_box;
        let [across, down] = self.scale;
        let bounding_box = BoundingBox { x: x * across, y: y * down, width: width * across, height: height * down };
        Some(Mark { bounding_box, colour, label: format!("{}{suffix}", object.object), pose })
    }

    /// All views in a row, each as high as the lowest.
    #[must_use]
    pub fn side_by_side(views: &[RgbImage]) -> RgbImage {
        let height = views.iter().map(RgbImage::height).min().unwrap_or(1);
        let width_of = |view: &RgbImage| (view.width() * height / view.height()).max(1);
        let mut row = RgbImage::new(views.iter().map(width_of).sum::<u32>().max(1), height);
        let mut left = 0;
        for view in views {
            let width = width_of(view);
            if view.height() == height {
                imageops::replace(&mut row, view, left, 0);
            } else {
                imageops::replace(&mut row, &imageops::resize(view, width, height, FilterType::Triangle), left, 0);
            }
            left += i64::from(width);
        }
        row
    }
}
