use std::path::{Path, PathBuf};

use super::file_version::FileVersion;
use super::manifest::{MAX_JSON_BYTES, ManifestError, read_bytes, sha256_hex};
use super::reference::{Reference, ReferenceError};

/// A reference, and which file it came from.
#[derive(Clone, Debug)]
pub struct InForce {
    pub reference: Reference,
    pub sha256: String,
    pub version: FileVersion,
    /// Where the images that it was measured on lie, by their names.
    pub images: PathBuf,
}

impl InForce {
    /// Reads the reference of an object, which must belong to the keypoint net with this hash.
    pub(super) fn read(
        path: &Path,
        object: &str,
        keypoint_model_sha256: &str,
        images: PathBuf,
    ) -> Result<Self, ReferenceError> {
        // Before the file is read: what is written meanwhile is noticed later.
        let version = FileVersion::of(path).map_err(|source| ManifestError::Read { path: path.into(), source })?;
        let bytes = read_bytes(path, MAX_JSON_BYTES)?;
        let reference = Reference::parse(path, &bytes, object, keypoint_model_sha256)?;
        Ok(Self { reference, sha256: sha256_hex(&bytes), version, images })
    }
}
