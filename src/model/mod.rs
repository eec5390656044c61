//! Model folders, reference files and the runtime that runs the networks. Everything read here is untrusted.

mod manifest;
mod reference;
mod runtime;
mod store;

pub(crate) use manifest::read_json;
pub use manifest::{DetectorManifest, KeypointManifest, ManifestError};
pub(crate) use reference::write_atomically;
pub use reference::{Method, PoseFile, Reference, ReferenceError, ReferenceView};
pub use runtime::{Network, Runtime, RuntimeError, Tensor};
pub use store::{Detector, KeypointModel, LoadError, Store, StorePaths};
