use std::path::PathBuf;

use thiserror::Error;

use super::manifest::ManifestError;
use super::network::RuntimeError;
use super::reference::ReferenceError;
use posed_core::geometry::SymmetryError;

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
    #[error("{}: no object can be called \"detector\": that is the folder of the shared detector", path.display())]
    Reserved { path: PathBuf },
    #[error("cannot read the models folder {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error("{} has no object: no folder with an object.json, and no detector", path.display())]
    Empty { path: PathBuf },
    #[error(
        "{}: its labels {labels:?} do not have {name:?}, the object whose folder it is in; add the label, or move the \
         detector to models/detector", path.display()
    )]
    Label { path: PathBuf, name: String, labels: Vec<String> },
}
