use std::path::{Path, PathBuf};

use thiserror::Error;

use super::manifest::{DetectorManifest, KeypointManifest, ManifestError, read_model};
use super::reference::{Reference, ReferenceError};
use super::runtime::{Network, Runtime, RuntimeError};
use crate::geometry::{Symmetries, SymmetryError};

/// Where the models and references lie.
#[derive(Clone, Debug)]
pub struct StorePaths {
    /// Holds `detector/` and one folder for each object.
    pub models: PathBuf,
    /// Holds `<object>.json` for each calibrated object.
    pub reference: PathBuf,
}

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
    #[error("{}: the folder is named {folder:?} but its manifest names the object {name:?}", path.display())]
    Name { path: PathBuf, folder: String, name: String },
    #[error("object {name:?} has no model: {} does not exist", path.display())]
    NoModel { name: String, path: PathBuf },
}

pub struct Detector {
    pub manifest: DetectorManifest,
    pub network: Network,
}

/// A keypoint net with its manifest, and its reference where there is one.
pub struct KeypointModel {
    pub manifest: KeypointManifest,
    pub symmetries: Symmetries,
    pub network: Network,
    /// Without it the object is known but its poses cannot be given.
    pub reference: Option<Reference>,
}

/// Everything loaded from disk.
pub struct Store {
    pub detector: Detector,
    /// One entry for each of the detector's classes; `None` where there is no model folder.
    pub objects: Vec<Option<KeypointModel>>,
}

impl Store {
    /// Loads the detector, and the model and reference of each of its classes that has a model folder.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(paths: &StorePaths, runtime: &Runtime) -> Result<Self, LoadError> {
        let folder = paths.models.join("detector");
        let manifest = DetectorManifest::read(&folder.join("detector.json"))?;
        let network = load_network(runtime, &folder.join("detector.onnx"), &manifest.model_sha256)?;
        let objects = manifest
            .labels
            .iter()
            .map(|label| {
                let known = paths.models.join(label).is_dir();
                known.then(|| KeypointModel::load(paths, label, runtime)).transpose()
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self { detector: Detector { manifest, network }, objects })
    }
}

impl Store {
    /// The objects whose poses can be given.
    pub fn calibrated(&self) -> impl Iterator<Item = &KeypointModel> {
        self.objects.iter().flatten().filter(|model| model.reference.is_some())
    }

    /// Names of the detector's classes whose poses cannot be given, and why.
    pub fn unserved(&self) -> impl Iterator<Item = (&str, &'static str)> {
        self.detector.manifest.labels.iter().zip(&self.objects).filter_map(|(label, model)| match model {
            None => Some((label.as_str(), "it has no model folder")),
            Some(KeypointModel { reference: None, .. }) => Some((label.as_str(), "it is not calibrated")),
            Some(KeypointModel { reference: Some(_), .. }) => None,
        })
    }
}

impl KeypointModel {
    /// Loads one object's model, and its reference if there is one.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(paths: &StorePaths, name: &str, runtime: &Runtime) -> Result<Self, LoadError> {
        let mut model = Self::load_uncalibrated(paths, name, runtime)?;
        let path = paths.reference.join(format!("{name}.json"));
        if path.exists() {
            model.reference = Some(Reference::read(&path, &model.manifest.model_sha256)?);
        }
        Ok(model)
    }

    /// Loads one object's model and leaves its reference alone: to make a new one.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load_uncalibrated(paths: &StorePaths, name: &str, runtime: &Runtime) -> Result<Self, LoadError> {
        let folder = paths.models.join(name);
        if !folder.is_dir() {
            return Err(LoadError::NoModel { name: name.into(), path: folder });
        }
        let path = folder.join("object.json");
        let manifest = KeypointManifest::read(&path)?;
        if manifest.name != name {
            return Err(LoadError::Name { path, folder: name.into(), name: manifest.name });
        }
        let network = load_network(runtime, &folder.join("keypoints.onnx"), &manifest.model_sha256)?;
        let symmetries = manifest.symmetries()?;
        Ok(Self { manifest, symmetries, network, reference: None })
    }
}

fn load_network(runtime: &Runtime, path: &Path, sha256: &str) -> Result<Network, LoadError> {
    let bytes = read_model(path, sha256)?;
    Ok(runtime.network(&path.display().to_string(), &bytes)?)
}
