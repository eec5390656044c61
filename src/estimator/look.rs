//! Where in an image something is to be looked at closely: boxes of the caller, or what all detectors see together.

use fast_image_resize::Resizer;
use image::RgbImage;

use super::answer::{EstimateError, GivenBox};
use super::detect::{MAX_DETECTIONS, Seen, Wanted, detect};
use super::given;
use super::watchdog::Activity;
use crate::model::{Library, Network};

/// The detectors of a library, in its order, and what they work with.
pub(super) struct Eyes<'a> {
    pub library: &'a Library,
    pub detectors: &'a mut [Box<dyn Network>],
    pub resizer: &'a mut Resizer,
    pub activity: &'a Activity,
}

impl Eyes<'_> {
    /// What an image shows of what is wanted. Each object has one detector, so what several see is put together as it is.
    pub(super) fn look(
        &mut self,
        image: &RgbImage,
        boxes: Option<&[GivenBox]>,
        wanted: &Wanted,
    ) -> Result<Seen, EstimateError> {
        if let Some(boxes) = boxes {
            let detections = given::detections(boxes, self.library, wanted, image.dimensions())?;
            return Ok(Seen { detections, ..Seen::default() });
        }
        let mut all = Seen::default();
        for (looking, network) in self.library.detectors.iter().zip(self.detectors.iter_mut()) {
            if !looking.objects.iter().flatten().any(|place| wanted.object(*place)) {
                continue;
            }
            let _running = match &looking.owner {
                None => self.activity.runs("the detector"),
                Some(owner) => self.activity.runs(&format!("the detector of {owner}")),
            };
            let seen = detect(looking, network.as_mut(), self.resizer, image, wanted)?;
            all.detections.extend(seen.detections);
            all.covered.extend(seen.covered);
            all.truncated |= seen.truncated;
            all.elapsed += seen.elapsed;
        }
        all.detections.sort_by(|a, b| b.score.total_cmp(&a.score));
        all.truncated |= all.detections.len() > MAX_DETECTIONS;
        all.detections.truncate(MAX_DETECTIONS);
        Ok(all)
    }
}
