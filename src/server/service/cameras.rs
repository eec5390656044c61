use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::model::{ManifestError, read_json};
use posed_core::geometry::Camera;

/// A camera folder that cannot be used.
#[derive(Debug, Error)]
pub(crate) enum CameraFolderError {
    #[error("cannot read the camera folder {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    File(#[from] ManifestError),
}

/// Cameras by id: `left.camera.json` is camera `left`.
#[derive(Debug, Default)]
pub(crate) struct Cameras {
    by_id: BTreeMap<String, Camera>,
}

const SUFFIX: &str = ".camera.json";

impl Cameras {
    /// Reads every `*.camera.json` of a folder.
    ///
    /// # Errors
    /// When the folder or one of the files cannot be read, or a file describes no camera.
    pub(crate) fn read(folder: &Path) -> Result<Self, CameraFolderError> {
        let unreadable = |source| CameraFolderError::Folder { path: folder.into(), source };
        let mut by_id = BTreeMap::new();
        for entry in std::fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            let id = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_suffix(SUFFIX));
            if let Some(id) = id {
                by_id.insert(id.to_owned(), read_json(&path)?);
            }
        }
        Ok(Self { by_id })
    }

    #[must_use]
    pub(crate) fn get(&self, id: &str) -> Option<&Camera> {
        self.by_id.get(id)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&str, &Camera)> {
        self.by_id.iter().map(|(id, camera)| (id.as_str(), camera))
    }

    pub(crate) fn ids(&self) -> impl Iterator<Item = &str> {
        self.by_id.keys().map(String::as_str)
    }
}
