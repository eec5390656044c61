//! Requests and answers as JSON, with their schemas.

mod forms;
mod report;
mod trust;

pub(in crate::server) use forms::{CameraForm, PoseForm};
pub use report::{
    AlternativeReport, DetectionReport, ExifReport, ImageReport, KeypointReport, ModelsReport, PlacedReport,
    PoseReport, Report, ReportContext, SolvedReport, TimingsReport, TransformReport,
};
pub use trust::{ReasonForm, StatusForm};
