//! Requests and answers as JSON, with their schemas.

mod errors;
mod forms;
mod info;
mod recalibration;
mod report;
mod requests;
mod rig;
mod status;
mod transform;
mod trust;
mod views;

pub(crate) use errors::{ErrorBody, ErrorDetail};
pub(crate) use forms::{CameraForm, RawForm};
pub(crate) use info::{LimitsReport, ObjectReport, ReferenceReport};
pub(crate) use recalibration::ReferenceRequest;
pub use report::{
    AlternativeReport, DetectionReport, ExifReport, ImageReport, KeypointReport, ModelsReport, PoseReport, Report,
    ReportContext, SolvedReport, TimingsReport,
};
pub(crate) use requests::{BatchRequest, EstimateRequest};
pub(crate) use rig::RigReport;
pub(crate) use status::StatusReport;
pub use transform::{PlacedReport, TransformReport};
pub use trust::{ReasonForm, StatusForm};
pub(crate) use views::ViewsForm;
pub use views::{FusedReport, LeftOutForm, ScaleReport, ViewReport, ViewShareReport, ViewsReport};
