//! What the server can do, for every front end: HTTP and gRPC translate, call this, and translate back.

mod access;
mod boxes;
mod cameras;
mod estimate;
mod failure;
mod limits;
mod memory;
mod metrics;
mod objects;
mod options;
mod readiness;
mod recalibrate;
mod recent;
mod reference_image;
mod state;
mod status;
mod track;
mod views;
mod watch;

pub(crate) use access::{Access, AccessError, Scope};
pub(crate) use boxes::RequestedBox;
pub(crate) use estimate::PoseWork;
pub(crate) use failure::{Failure, FailureKind};
pub(crate) use limits::{Connections, Limits, MAX_JSON_BYTES, MemoryBound};
pub(crate) use objects::KnownObject;
pub(crate) use options::{CameraChoice, Options, PoseRequest};
pub(crate) use readiness::Readiness;
pub(crate) use recalibrate::{ClickedPose, KnownPose, KnownView, Recalibration};
pub(crate) use recent::Latency;
pub(crate) use reference_image::ReferenceImage;
pub(crate) use state::{Answered, LoadFailure, Service};
pub(crate) use status::StatusSnapshot;
pub(crate) use track::{TrackedStream, Tracking};
pub(crate) use views::{ViewCamera, ViewCameras, ViewsAnswer, ViewsRequest, ViewsWork};
