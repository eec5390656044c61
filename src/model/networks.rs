use super::library::Library;
use super::network::{Backend, KeypointNet, Network, RuntimeError};

/// One worker's networks.
pub struct Networks {
    pub detector: Box<dyn Network>,
    /// One entry for each of the library's objects.
    pub keypoints: Vec<Option<KeypointNet>>,
}

impl Networks {
    /// Loads every network of a library.
    ///
    /// # Errors
    /// When one of them cannot be run.
    pub fn load(library: &Library, backend: &dyn Backend) -> Result<Self, RuntimeError> {
        let keypoints = library
            .objects
            .iter()
            .map(|object| object.as_ref().map(|object| object.network(backend)).transpose())
            .collect::<Result<_, _>>()?;
        Ok(Self { detector: library.detector.network(backend)?, keypoints })
    }
}
