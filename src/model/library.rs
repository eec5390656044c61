use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::manifest::{DetectorManifest, KeypointManifest, ManifestError, read_model};
use super::network::{Backend, KeypointNet, Network, RuntimeError, SizeInput};
use super::provider::Provider;
use super::reference::ReferenceError;
use posed_core::geometry::{Symmetries, SymmetryError};

/// Models that cannot be loaded.
#[derive(Debug, Error)]
pub enum LoadError {
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    #[error(transparent)]
    Symmetries(#[from] SymmetryError),
    #[error("{}: the manifest is for object {name:?}, but its folder is {folder:?}; rename one of them", path.display())]
    Name { path: PathBuf, folder: String, name: String },
    #[error("object {name:?} has no model: {} does not exist", path.display())]
    NoModel { name: String, path: PathBuf },
}

/// The detector as it lies on disk, checked.
pub struct DetectorModel {
    pub manifest: DetectorManifest,
    /// The file's path: for messages.
    name: String,
    bytes: Vec<u8>,
}

/// A keypoint net as it lies on disk, checked.
pub struct ObjectModel {
    pub manifest: KeypointManifest,
    pub symmetries: Symmetries,
    name: String,
    bytes: Vec<u8>,
}

/// Every model, in memory: a worker makes its networks from it, and again after a fault.
pub struct Library {
    pub detector: DetectorModel,
    /// One entry for each of the detector's classes; `None` where the class is no object or has no model folder.
    pub objects: Vec<Option<ObjectModel>>,
}

/// Which networks answer, and what they run on.
#[derive(Clone, Debug)]
pub struct ModelsInUse {
    pub provider: Provider,
    /// SHA-256 of the detector's file.
    pub detector: String,
    /// SHA-256 of each object's keypoint net.
    pub keypoints: BTreeMap<String, String>,
}

impl ModelsInUse {
    #[must_use]
    pub fn new(library: &Library, provider: Provider) -> Self {
        let of_object = |object: &KeypointManifest| (object.name.clone(), object.model_sha256.clone());
        Self {
            provider,
            detector: library.detector.manifest.model_sha256.clone(),
            keypoints: library.known().map(|object| of_object(&object.manifest)).collect(),
        }
    }
}

impl Library {
    /// Loads the detector, and the model of each of its classes that has a model folder. `folder` holds `detector/` and
    /// one folder for each object.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(folder: &Path) -> Result<Self, LoadError> {
        let manifest = DetectorManifest::read(&folder.join("detector/detector.json"))?;
        let path = folder.join("detector/detector.onnx");
        let bytes = read_model(&path, &manifest.model_sha256)?;
        let objects = manifest
            .labels
            .iter()
            .map(|label| {
                let known = label.as_ref().filter(|label| folder.join(label).is_dir());
                known.map(|label| ObjectModel::load(folder, label)).transpose()
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self { detector: DetectorModel { manifest, name: path.display().to_string(), bytes }, objects })
    }

    /// With another probability from which on poses are `ok`, for all objects that state what their evidence is worth.
    #[must_use]
    pub fn with_ok_probability(mut self, ok_probability: Option<f64>) -> Self {
        if let Some(ok_probability) = ok_probability {
            for trust in self.objects.iter_mut().flatten().filter_map(|object| object.manifest.trust.as_mut()) {
                trust.ok_probability = ok_probability;
            }
        }
        self
    }

    /// The objects that have a keypoint net.
    pub fn known(&self) -> impl Iterator<Item = &ObjectModel> {
        self.objects.iter().flatten()
    }

    /// The object of a name.
    #[must_use]
    pub fn object(&self, name: &str) -> Option<&ObjectModel> {
        self.known().find(|object| object.manifest.name == name)
    }

    /// Names of the detector's classes that have no model folder.
    pub fn without_model(&self) -> impl Iterator<Item = &str> {
        let labels = self.detector.manifest.labels.iter().zip(&self.objects);
        labels.filter(|(_, object)| object.is_none()).filter_map(|(label, _)| label.as_deref())
    }
}

impl DetectorModel {
    /// The detector, ready to run.
    ///
    /// # Errors
    /// When it cannot be run.
    pub fn network(&self, backend: &dyn Backend) -> Result<Box<dyn Network>, RuntimeError> {
        let input = &self.manifest.input;
        let size = |name| SizeInput { name, width: input.width, height: input.height };
        backend.load(&self.name, &self.bytes, input.size_input.as_deref().map(size))
    }
}

impl ObjectModel {
    /// Loads one object's model from `folder/<name>/`.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(folder: &Path, name: &str) -> Result<Self, LoadError> {
        let folder = folder.join(name);
        if !folder.is_dir() {
            return Err(LoadError::NoModel { name: name.into(), path: folder });
        }
        let path = folder.join("object.json");
        let manifest = KeypointManifest::read(&path)?;
        if manifest.name != name {
            return Err(LoadError::Name { path, folder: name.into(), name: manifest.name });
        }
        let path = folder.join("keypoints.onnx");
        let bytes = read_model(&path, &manifest.model_sha256)?;
        Ok(Self { symmetries: manifest.symmetries()?, manifest, name: path.display().to_string(), bytes })
    }

    /// The keypoint net, ready to run.
    ///
    /// # Errors
    /// When it cannot be run.
    pub fn network(&self, backend: &dyn Backend) -> Result<KeypointNet, RuntimeError> {
        backend.load(&self.name, &self.bytes, None).map(KeypointNet::new)
    }
}
