use std::io;
use std::path::PathBuf;

use thiserror::Error;

use super::VERSION;

/// A bundle that is not as `docs/bundle.md` says.
#[derive(Debug, Error)]
pub enum BundleError {
    // What the reader of tar files says quotes the bytes that it met.
    #[error("the bundle is no tar file, or is damaged ({})", .0.to_string().escape_default())]
    Tar(io::Error),
    #[error("the first file of the bundle is {0:?}; it must be 'bundle.json' (a bundle is an uncompressed tar file)")]
    NotFirst(String),
    #[error("bundle.json: {0}")]
    Json(#[from] serde_json::Error),
    #[error("bundle.json: field '{field}' {problem}")]
    Field { field: &'static str, problem: String },
    #[error(
        "bundle.json: field 'version' is {found}, {}", if *found < VERSION.into() {
            format!("which is older than {VERSION}, the version that is read here; export the object again with `posed-train export`")
        } else {
            format!("which is newer than {VERSION}, the version that is read here; update posed, or export with an older posed-train")
        }
    )]
    Version { found: u64 },
    #[error("the bundle holds {name:?}, which {problem}")]
    Entry { name: String, problem: String },
    #[error("the bundle ends without {name:?}, which bundle.json names")]
    Missing { name: String },
    #[error("the bundle goes on after its end")]
    Trailing,
    #[error("the files of the bundle have {bytes} bytes in all, more than {limit}")]
    TooLarge { bytes: u64, limit: u64 },
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
}
