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

use serde::Deserialize;

use crate::server::service::Failure;

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

/// The part `request` of a form; what cannot be read is named by its path.
pub(crate) fn read_request<'a, T: Deserialize<'a>>(text: &'a [u8]) -> Result<T, Failure> {
    let bad = |place: &str, error: &serde_json::Error| Failure::invalid(format!("part 'request': {place}{error}"));
    let mut json = serde_json::Deserializer::from_slice(text);
    let request = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let path = error.path().to_string();
        // What is wrong with all of it has the path ".".
        let place = if path.starts_with('.') { String::new() } else { format!("field '{path}': ") };
        bad(&place, error.inner())
    })?;
    json.end().map_err(|error| bad("", &error))?;
    Ok(request)
}
