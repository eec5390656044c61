use std::sync::Arc;

use super::library::{Library, Looking};
use super::network::{Backend, KeypointNet, Network, RuntimeError};
use super::object::ObjectModel;

/// One worker's networks.
pub struct Networks {
    /// One entry for each of the library's detectors.
    pub detectors: Vec<Box<dyn Network>>,
    /// One entry for each of the library's objects.
    pub keypoints: Vec<Option<KeypointNet>>,
}

/// The networks that a library needs beside those that another one has.
pub struct NewNetworks {
    /// One entry for each of the library's detectors; `None` where the other one has it.
    pub detectors: Vec<Option<Box<dyn Network>>>,
    /// One entry for each of the library's objects.
    pub keypoints: Vec<Option<KeypointNet>>,
}

impl Networks {
    /// Loads every network of a library.
    ///
    /// # Errors
    /// When one of them cannot be run.
    pub fn load(library: &Library, backend: &dyn Backend) -> Result<Self, RuntimeError> {
        let NewNetworks { detectors, keypoints } = NewNetworks::load(library, None, backend)?;
        Ok(Self { detectors: detectors.into_iter().flatten().collect(), keypoints })
    }

    /// Those of another library: new ones, and of the old ones those that go on.
    #[must_use]
    pub fn renewed(self, old: &Library, new: &Library, networks: NewNetworks) -> Self {
        let mut old_detectors: Vec<Option<Box<dyn Network>>> = self.detectors.into_iter().map(Some).collect();
        let detectors = new.detectors.iter().zip(networks.detectors).filter_map(|(looking, network)| {
            let kept = || {
                let place = old.detectors.iter().position(|one| Arc::ptr_eq(&one.model, &looking.model))?;
                old_detectors[place].take()
            };
            network.or_else(kept)
        });
        let detectors = detectors.collect();
        let mut old_keypoints = self.keypoints;
        let keypoints = networks.keypoints.into_iter().enumerate().map(|(place, network)| {
            let goes_on = new.objects[place].is_some();
            network.or_else(|| old_keypoints.get_mut(place).filter(|_| goes_on)?.take())
        });
        Self { detectors, keypoints: keypoints.collect() }
    }
}

impl NewNetworks {
    /// Loads what another library does not have.
    ///
    /// # Errors
    /// When a network cannot be run.
    pub fn load(library: &Library, beside: Option<&Library>, backend: &dyn Backend) -> Result<Self, RuntimeError> {
        let has_detector = |looking: &Looking| {
            beside.is_some_and(|other| other.detectors.iter().any(|one| Arc::ptr_eq(&one.model, &looking.model)))
        };
        let has_object = |place: usize| {
            let other = beside.and_then(|other| other.objects.get(place)?.as_ref());
            other.zip(library.objects[place].as_ref()).is_some_and(|(other, object)| Arc::ptr_eq(other, object))
        };
        let detector = |looking: &Looking| {
            if has_detector(looking) { Ok(None) } else { looking.model.network(backend).map(Some) }
        };
        let keypoints = |(place, object): (usize, &Option<Arc<ObjectModel>>)| {
            object.as_ref().filter(|_| !has_object(place)).map(|object| object.network(backend)).transpose()
        };
        Ok(Self {
            detectors: library.detectors.iter().map(detector).collect::<Result<_, _>>()?,
            keypoints: library.objects.iter().enumerate().map(keypoints).collect::<Result<_, _>>()?,
        })
    }
}
