//! Model folders, references, and the runtime of the networks.

mod evidence;
mod library;
mod manifest;
mod network;
mod networks;
mod onnx;
mod provider;
mod reference;
mod references;
mod rig;
mod runtime;

pub use evidence::Evidence;
pub use library::{DetectorModel, Library, LoadError, ModelsInUse, ObjectModel};
pub use manifest::{
    Channels, Coordinates, CovarianceTrust, CropVariant, DetectorFormat, DetectorInput, DetectorManifest, ElementType,
    KeypointInput, KeypointManifest, KeypointOutput, Layout, Linear, ManifestError, PixelFormat, Placement, SecondLook,
    Trust,
};
pub(crate) use manifest::{read_json, read_regular};
pub use network::{Backend, Input, KeypointNet, Network, Output, Outputs, RuntimeError, SizeInput};
pub use networks::Networks;
pub use provider::Provider;
pub(crate) use reference::write_atomically;
pub use reference::{Method, PoseFile, Reference, ReferenceError, ReferenceView};
pub use references::{FileVersion, InForce, References};
pub use rig::{Rig, RigCamera, RigError};
pub use runtime::{Runtime, available_cores};
