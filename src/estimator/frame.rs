use image::RgbImage;
use posed_core::geometry::Camera;

use super::answer::{Abandoned, Selection};
use super::expected::Guide;

/// One image to estimate poses from.
pub struct Frame<'a> {
    pub image: &'a RgbImage,
    /// The camera that took it; scaled where the selection allows that and the image is the camera's image resized.
    pub camera: &'a Camera,
    pub selection: &'a Selection,
    /// What earlier images of its stream say; without it the detector looks.
    pub guide: Option<&'a Guide>,
    /// Asked before each stage; an error where nobody waits for the answer any more.
    pub abandoned: &'a (dyn Fn() -> Result<(), Abandoned> + Sync),
}

impl<'a> Frame<'a> {
    /// An image whose answer is wanted in any case, with all its objects.
    #[must_use]
    pub fn new(image: &'a RgbImage, camera: &'a Camera) -> Self {
        Self { image, camera, selection: &Selection::ALL, guide: None, abandoned: &|| Ok(()) }
    }
}
