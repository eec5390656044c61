use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::detector::DetectorModel;
use super::file_version::FolderVersion;
use super::in_force::InForce;
use super::load_error::LoadError;
use super::manifest::{KeypointManifest, read_model};
use super::network::{Backend, KeypointNet, LoadOptions, RuntimeError};
use super::reference::ReferenceError;
use posed_core::geometry::Symmetries;

/// The folder of the shared detector, which no object can have.
pub(crate) const DETECTOR: &str = "detector";

/// What an object's folder holds, checked: a keypoint net, and what it may bring along.
pub struct ObjectModel {
    pub manifest: KeypointManifest,
    pub symmetries: Symmetries,
    /// A detector of its own (`detector/`).
    pub detector: Option<Arc<DetectorModel>>,
    /// A reference of its own (`reference.json`), or why it cannot be used.
    pub(super) reference: Option<Result<Arc<InForce>, String>>,
    version: FolderVersion,
    name: String,
    bytes: Vec<u8>,
}

impl ObjectModel {
    /// Loads one object's model from `models/<name>/`.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(models: &Path, name: &str) -> Result<Self, LoadError> {
        let folder = models.join(name);
        Self::load_staged(&folder, &folder, name)
    }

    /// As [`load`](Self::load), from a folder that will be moved to `home`.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_staged(folder: &Path, home: &Path, name: &str) -> Result<Self, LoadError> {
        if !folder.is_dir() {
            return Err(LoadError::NoModel { name: name.into(), path: folder.into() });
        }
        // Before anything is read: what is written meanwhile is noticed later.
        let version = FolderVersion::of(folder);
        let path = folder.join("object.json");
        let manifest = KeypointManifest::read(&path)?;
        if manifest.name != name {
            return Err(LoadError::Name { path, folder: name.into(), name: manifest.name });
        }
        if name == DETECTOR {
            return Err(LoadError::Reserved { path });
        }
        let path = folder.join("keypoints.onnx");
        let bytes = read_model(&path, &manifest.model_sha256)?;
        Ok(Self {
            symmetries: manifest.symmetries()?,
            detector: own_detector(folder, name)?.map(Arc::new),
            reference: own_reference(folder, home, &manifest)?,
            manifest,
            version,
            name: path.display().to_string(),
            bytes,
        })
    }

    /// The keypoint net, ready to run.
    ///
    /// # Errors
    /// When it cannot be run.
    pub fn network(&self, backend: &dyn Backend) -> Result<KeypointNet, RuntimeError> {
        // A first look at one box, and the crops of a further one.
        let mut batches = vec![1, self.manifest.crop_ensemble.len().max(1)];
        batches.dedup();
        let options = LoadOptions { size: None, batches: &batches };
        backend.load(&self.name, &self.bytes, options).map(KeypointNet::new)
    }

    /// Why the reference that its folder brings along cannot be used.
    #[must_use]
    pub fn reference_problem(&self) -> Option<&str> {
        self.reference.as_ref()?.as_ref().err().map(String::as_str)
    }

    /// The files that it was loaded from.
    #[must_use]
    pub fn version(&self) -> &FolderVersion {
        &self.version
    }
}

fn own_detector(folder: &Path, name: &str) -> Result<Option<DetectorModel>, LoadError> {
    let folder = folder.join("detector");
    if !folder.is_dir() {
        return Ok(None);
    }
    let detector = DetectorModel::load(&folder)?;
    if detector.class_of(name).is_none() {
        let labels = detector.manifest.labels.iter().flatten().cloned().collect();
        return Err(LoadError::Label { path: folder.join("detector.json"), name: name.into(), labels });
    }
    Ok(Some(detector))
}

fn own_reference(
    folder: &Path,
    home: &Path,
    manifest: &KeypointManifest,
) -> Result<Option<Result<Arc<InForce>, String>>, LoadError> {
    let path: PathBuf = folder.join("reference.json");
    if !path.exists() {
        return Ok(None);
    }
    match InForce::read(&path, &manifest.name, &manifest.model_sha256, home.join("reference")) {
        Ok(in_force) => Ok(Some(Ok(Arc::new(in_force)))),
        Err(error @ ReferenceError::OtherModel { .. }) => Ok(Some(Err(error.of_another_net()))),
        Err(error) => Err(error.into()),
    }
}
