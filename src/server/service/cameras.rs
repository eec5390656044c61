use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::model::{ManifestError, Rig, RigError, read_json};
use posed_core::geometry::Camera;

/// A camera folder that cannot be used.
#[derive(Debug, Error)]
pub(crate) enum CameraFolderError {
    #[error("cannot read the camera folder {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    File(#[from] ManifestError),
    #[error(transparent)]
    Rig(#[from] RigError),
}

/// Cameras and rigs by id: `left.camera.json` is camera `left`, `cell.rig.json` rig `cell`.
#[derive(Debug, Default)]
pub(crate) struct Cameras {
    by_id: BTreeMap<String, Camera>,
    rigs: BTreeMap<String, Rig>,
}

const SUFFIX: &str = ".camera.json";

impl Cameras {
    /// Reads every `*.camera.json` and `*.rig.json` of a folder.
    ///
    /// # Errors
    /// When the folder or one of the files cannot be read, or a file describes no camera or rig.
    pub(crate) fn read(folder: &Path) -> Result<Self, CameraFolderError> {
        let unreadable = |source| CameraFolderError::Folder { path: folder.into(), source };
        let (mut by_id, mut rig_files) = (BTreeMap::new(), Vec::new());
        for entry in std::fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
            if let Some(id) = name.strip_suffix(SUFFIX) {
                by_id.insert(id.to_owned(), read_json(&path)?);
            } else if let Some(id) = name.strip_suffix(Rig::SUFFIX) {
                rig_files.push((id.to_owned(), path));
            }
        }
        let mut rigs = BTreeMap::new();
        for (id, path) in rig_files {
            rigs.insert(id, Rig::read(&path, |id| by_id.get(id).cloned())?);
        }
        Ok(Self { by_id, rigs })
    }

    #[must_use]
    pub(crate) fn get(&self, id: &str) -> Option<&Camera> {
        self.by_id.get(id)
    }

    #[must_use]
    pub(crate) fn rig(&self, id: &str) -> Option<&Rig> {
        self.rigs.get(id)
    }

    pub(crate) fn rigs(&self) -> impl Iterator<Item = (&str, &Rig)> {
        self.rigs.iter().map(|(id, rig)| (id.as_str(), rig))
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&str, &Camera)> {
        self.by_id.iter().map(|(id, camera)| (id.as_str(), camera))
    }

    pub(crate) fn ids(&self) -> impl Iterator<Item = &str> {
        self.by_id.keys().map(String::as_str)
    }
}
