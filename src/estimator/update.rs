//! Another catalogue for workers that serve: what it needs beside the one they have, loaded and run before they get it.

use std::sync::Arc;

use fast_image_resize::Resizer;
use image::RgbImage;
use thiserror::Error;

use super::answer::EstimateError;
use super::detect::{Wanted, detect};
use super::keypoints;
use crate::model::{
    Backend, Catalogue, KeypointNet, Library, Looking, Network, NewNetworks, ObjectModel, RuntimeError,
};
use crate::vision::BoundingBox;

/// What one worker goes on with.
pub struct Update {
    pub(super) catalogue: Arc<Catalogue>,
    pub(super) networks: NewNetworks,
}

/// Networks that workers cannot go on with.
#[derive(Debug, Error)]
pub enum UpdateError {
    #[error(transparent)]
    Load(#[from] RuntimeError),
    #[error("the networks cannot be run: {0}")]
    WarmUp(#[from] EstimateError),
}

impl Update {
    /// Loads and runs the networks that `catalogue` has and `old` has not.
    ///
    /// # Errors
    /// When one of them cannot be loaded or run.
    pub fn prepare(
        old: Option<&Library>,
        catalogue: &Arc<Catalogue>,
        backend: &dyn Backend,
    ) -> Result<Self, UpdateError> {
        let library = &catalogue.library;
        let mut networks = NewNetworks::load(library, old, backend)?;
        let detectors = library.detectors.iter().zip(&mut networks.detectors);
        let keypoints = library.objects.iter().zip(&mut networks.keypoints);
        warm_up(
            detectors.filter_map(|(looking, network)| Some((looking, network.as_mut()?.as_mut()))),
            keypoints.filter_map(|(object, network)| object.as_deref().zip(network.as_mut())),
        )?;
        Ok(Self { catalogue: Arc::clone(catalogue), networks })
    }
}

/// Runs networks once: the first run of a session allocates.
pub(super) fn warm_up<'a>(
    detectors: impl Iterator<Item = (&'a Looking, &'a mut (dyn Network + 'static))>,
    keypoints: impl Iterator<Item = (&'a ObjectModel, &'a mut KeypointNet)>,
) -> Result<(), EstimateError> {
    let mut resizer = Resizer::new();
    let image = RgbImage::from_pixel(640, 480, image::Rgb([114; 3]));
    let region = BoundingBox { x: 256.0, y: 176.0, width: 128.0, height: 128.0 };
    let wanted = Wanted { objects: Vec::new(), least_score: 0.0 };
    for (looking, network) in detectors {
        detect(looking, network, &mut resizer, &image, &wanted)?;
    }
    for (model, network) in keypoints {
        keypoints::warm_up(&model.manifest, network, &mut resizer, &image, region)?;
    }
    Ok(())
}
