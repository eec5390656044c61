use std::path::Path;

use super::file_version::FolderVersion;
use super::load_error::LoadError;
use super::manifest::{DetectorManifest, read_model};
use super::network::{Backend, LoadOptions, Network, RuntimeError, SizeInput};

/// A detector as it lies on disk, checked.
pub struct DetectorModel {
    pub manifest: DetectorManifest,
    version: FolderVersion,
    /// The file's path: for messages.
    name: String,
    bytes: Vec<u8>,
}

impl DetectorModel {
    /// Loads `detector.json` and `detector.onnx` of a folder.
    ///
    /// # Errors
    /// [`LoadError`] names the file, and the field where there is one.
    pub fn load(folder: &Path) -> Result<Self, LoadError> {
        // Before anything is read: what is written meanwhile is noticed later.
        let version = FolderVersion::of(folder);
        let manifest = DetectorManifest::read(&folder.join("detector.json"))?;
        let path = folder.join("detector.onnx");
        let bytes = read_model(&path, &manifest.model_sha256)?;
        Ok(Self { manifest, version, name: path.display().to_string(), bytes })
    }

    /// The detector, ready to run.
    ///
    /// # Errors
    /// When it cannot be run.
    pub fn network(&self, backend: &dyn Backend) -> Result<Box<dyn Network>, RuntimeError> {
        let input = &self.manifest.input;
        let size = |name| SizeInput { name, width: input.width, height: input.height };
        let options = LoadOptions { size: input.size_input.as_deref().map(size), batches: &[1] };
        backend.load(&self.name, &self.bytes, options)
    }

    /// The files that it was loaded from.
    #[must_use]
    pub fn version(&self) -> &FolderVersion {
        &self.version
    }

    /// The class of an object.
    #[must_use]
    pub fn class_of(&self, object: &str) -> Option<usize> {
        self.manifest.labels.iter().position(|label| label.as_deref() == Some(object))
    }
}
