//! An object in one file: `docs/bundle.md`.

mod error;
mod format;
mod unpack;

pub use error::BundleError;
pub use format::BundleManifest;
pub use unpack::unpack;

/// The version of the format.
const VERSION: u32 = 1;
