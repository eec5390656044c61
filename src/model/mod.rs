//! Model folders, references, and the runtime of the networks.

mod bundle;
mod catalogue;
mod detector;
mod evidence;
mod file_version;
mod in_force;
mod left_over;
mod library;
mod load_error;
mod manifest;
mod network;
mod networks;
mod object;
mod onnx;
mod provider;
mod reference;
mod references;
mod rig;
mod runtime;
mod session;
mod store;

pub use bundle::{BundleError, BundleManifest, unpack};
pub use catalogue::{Catalogue, Current};
pub use detector::DetectorModel;
pub use evidence::Evidence;
pub use file_version::{FileVersion, FolderVersion};
pub use in_force::InForce;
pub use library::{Library, Looking};
pub use load_error::LoadError;
pub use manifest::{
    Channels, Coordinates, CovarianceTrust, CropVariant, DetectorFormat, DetectorInput, DetectorManifest, ElementType,
    KeypointInput, KeypointManifest, KeypointOutput, Layout, Linear, ManifestError, PixelFormat, Placement, SecondLook,
    Trust,
};
pub(crate) use manifest::{read_json, read_regular};
pub use network::{Backend, Input, KeypointNet, LoadOptions, Network, Output, Outputs, RuntimeError, SizeInput};
pub use networks::{Networks, NewNetworks};
pub(crate) use object::DETECTOR;
pub use object::ObjectModel;
pub use provider::{Provider, ProviderSetting};
pub(crate) use reference::KEYPOINTS_SCALE;
pub(crate) use reference::write_atomically;
pub use reference::{Method, PoseFile, Reference, ReferenceError, ReferenceView};
pub use references::References;
pub use rig::{Rig, RigCamera, RigError};
pub use runtime::{Runtime, available_cores};
pub use store::{Staged, Store, StoreError};
