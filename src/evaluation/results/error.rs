use std::path::PathBuf;

use thiserror::Error;

/// A file of estimates that cannot be read or written.
#[derive(Debug, Error)]
pub enum ResultsError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    #[error("{}: the first line must be '{header}'", path.display())]
    Header { path: PathBuf, header: String },
    #[error("{}: line {line}: {reason}", path.display())]
    Line { path: PathBuf, line: u64, reason: String },
    #[error("{}: column 't' of every line is shorter than {limit_mm} mm; these look like metres: multiply them by 1000", path.display())]
    Metres { path: PathBuf, limit_mm: f64 },
}
