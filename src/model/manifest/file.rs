use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use thiserror::Error;

/// A manifest or a reference of many views is far below this.
pub(in crate::model) const MAX_JSON_BYTES: u64 = 64 << 20;
/// An ONNX file is a protobuf message: none is larger.
pub(in crate::model) const MAX_MODEL_BYTES: u64 = 2 << 30;

/// A model folder that cannot be used. Every message names the file, and the field where there is one.
#[derive(Debug, Error)]
pub enum ManifestError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    #[error("{}: field '{field}' {problem}", path.display())]
    Field { path: PathBuf, field: &'static str, problem: String },
    #[error(
        "{} has sha256 {found} but its manifest states {stated}; the file is damaged, or belongs to another manifest",
        path.display()
    )]
    Hash { path: PathBuf, stated: String, found: String },
}

/// A field and what is wrong with it.
pub(super) type Invalid = (&'static str, String);

pub(super) fn read_manifest<T: DeserializeOwned>(
    path: &Path,
    validate: impl Fn(&T) -> Result<(), Invalid>,
) -> Result<T, ManifestError> {
    let manifest: T = read_json(path)?;
    validate(&manifest).map_err(|(field, problem)| ManifestError::Field { path: path.into(), field, problem })?;
    Ok(manifest)
}

/// Reads a model file and checks it against the hash that its manifest states.
pub(in crate::model) fn read_model(path: &Path, stated: &str) -> Result<Vec<u8>, ManifestError> {
    let bytes = read_bytes(path, MAX_MODEL_BYTES)?;
    let found = sha256_hex(&bytes);
    if !found.eq_ignore_ascii_case(stated) {
        return Err(ManifestError::Hash { path: path.into(), stated: stated.into(), found });
    }
    Ok(bytes)
}

/// Object names become file names and URL parts.
pub(in crate::model) fn check_name(name: &str) -> Result<(), String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if (1..=64).contains(&name.len()) && name.chars().all(allowed) {
        Ok(())
    } else {
        Err(format!("contains {name:?}; names have 1 to 64 letters, digits, '_' or '-'"))
    }
}

pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, ManifestError> {
    let text = read_bytes(path, MAX_JSON_BYTES)?;
    serde_json::from_slice(&text).map_err(|source| ManifestError::Json { path: path.into(), source })
}

pub(in crate::model) fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>, ManifestError> {
    read_regular(path, limit).map_err(|source| ManifestError::Read { path: path.into(), source })
}

/// Reads a regular file: a pipe might never end, or never begin.
pub(crate) fn read_regular(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    if !path.metadata()?.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(io::Error::other(format!("it is larger than {limit} bytes")));
    }
    Ok(bytes)
}

pub(in crate::model) fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

pub(in crate::model) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
