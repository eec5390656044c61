//! Objects, cameras, rigs, limits and state of the server.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use posed_core::geometry::Camera;

use super::path::ObjectName;
use crate::server::api::json::{CameraForm, ErrorBody, LimitsReport, ObjectReport, RigReport, StatusReport};
use crate::server::service::{Failure, Service};

/// Returns all known objects, calibrated or not.
#[utoipa::path(get, path = "/v1/objects", tag = "info", responses((status = 200, body = Vec<ObjectReport>)))]
pub(super) async fn objects(State(service): State<Arc<Service>>) -> Json<Vec<ObjectReport>> {
    Json(service.objects().into_iter().map(Into::into).collect())
}

/// Returns one known object.
#[utoipa::path(
    get,
    path = "/v1/objects/{name}",
    tag = "info",
    params(("name" = String, Path)),
    responses((status = 200, body = ObjectReport), (status = 404, description = "The object is unknown", body = ErrorBody))
)]
pub(super) async fn object(
    State(service): State<Arc<Service>>,
    ObjectName(name): ObjectName,
) -> Result<Json<ObjectReport>, Failure> {
    Ok(Json(service.object(&name)?.into()))
}

/// Returns all registered cameras, by id.
#[utoipa::path(get, path = "/v1/cameras", tag = "info", responses((status = 200, body = BTreeMap<String, CameraForm>)))]
pub(super) async fn cameras(State(service): State<Arc<Service>>) -> Json<BTreeMap<String, Camera>> {
    Json(service.cameras().map(|(id, camera)| (id.to_owned(), camera.clone())).collect())
}

/// Returns all registered rigs, by id.
#[utoipa::path(get, path = "/v1/rigs", tag = "info", responses((status = 200, body = BTreeMap<String, RigReport>)))]
pub(super) async fn rigs(State(service): State<Arc<Service>>) -> Json<BTreeMap<String, RigReport>> {
    Json(service.rigs().map(|(id, rig)| (id.to_owned(), rig.into())).collect())
}

/// Returns the limits of the server, and the memory bound that follows from them.
#[utoipa::path(get, path = "/v1/limits", tag = "info", responses((status = 200, body = LimitsReport)))]
pub(super) async fn limits(State(service): State<Arc<Service>>) -> Json<LimitsReport> {
    Json(LimitsReport::new(&service.limits, &service.memory.bound()))
}

/// Returns the state of the server: queue, rate, latency, outcomes, models, memory.
#[utoipa::path(get, path = "/v1/status", tag = "info", responses((status = 200, body = StatusReport)))]
pub(super) async fn status(State(service): State<Arc<Service>>) -> Json<StatusReport> {
    Json(StatusReport::new(service.status(), &service.limits, service.provider))
}
