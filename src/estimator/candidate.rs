//! An object that is to be served, before it is.

use std::path::Path;

use thiserror::Error;

use super::parity::{Parity, ParityError};
use super::update::UpdateError;
use crate::model::{Backend, LoadError, ObjectModel, ReferenceError};

/// An object that cannot be served here.
#[derive(Debug, Error)]
pub enum CandidateError {
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    #[error(transparent)]
    Parity(#[from] ParityError),
    #[error(
        "the keypoint net says something else here than where it was trained ({0}): export it again, or check ONNX Runtime"
    )]
    Differs(Parity),
    #[error(transparent)]
    Networks(#[from] UpdateError),
    #[error("{0}")]
    StaleReference(String),
}

/// Loads an object from a folder that will be moved to `home`, and compares its network with where it was trained.
///
/// # Errors
/// [`CandidateError`] names the file.
pub fn load_candidate(
    folder: &Path,
    home: &Path,
    name: &str,
    backend: &dyn Backend,
) -> Result<ObjectModel, CandidateError> {
    let object = ObjectModel::load_staged(folder, home, name)?;
    let parity = Parity::measure(folder, &object, backend)?;
    if let Some(parity) = parity.filter(|parity| !parity.holds()) {
        return Err(CandidateError::Differs(parity));
    }
    Ok(object)
}
