//! The services on the gRPC port: poses, health, reflection.

use std::any::Any;
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::http::Response;
use axum::{Router, middleware};
use tonic::Status;
use tonic::server::NamedService;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower_http::catch_panic::CatchPanicLayer;

use super::admit::{Admitting, MAX_CALLS, admit};
use super::calls::Calls;
use crate::proto;
use crate::proto::pose_service_server::PoseServiceServer;
use crate::server::front_end::{Context, FrontEnd, Protocol};
use crate::server::service::Readiness;

pub(in crate::server) const FRONT_END: FrontEnd = FrontEnd {
    name: "grpc",
    protocol: Protocol::Http2,
    address: |config| config.grpc,
    requests_bytes: (MAX_CALLS as u64) * CALL_BYTES,
    router: |context| Box::pin(router(context)),
};

/// What an open call takes beside its message, measured with idle streams, reflection, and full headers: 36 to 84 KiB.
const CALL_BYTES: u64 = 96 * 1024;
/// Protocol overhead of a request beyond its image.
const MESSAGE_OVERHEAD_BYTES: usize = 4096;
/// How often the health service is told what the probes know.
const HEALTH_INTERVAL: Duration = Duration::from_millis(500);

async fn router(context: Arc<Context>) -> Result<Router, Box<dyn Error + Send + Sync>> {
    let (health, health_service) = tonic_health::server::health_reporter();
    // Older tools speak the first version alone.
    let (reflection, reflection_v1alpha) = (reflection().build_v1()?, reflection().build_v1alpha()?);
    let limit = context.service.limits.max_body_bytes + MESSAGE_OVERHEAD_BYTES;
    let calls = Calls { service: Arc::clone(&context.service), stopping: context.stopping.clone() };
    let poses = PoseServiceServer::new(calls).max_decoding_message_size(limit);
    // Before the first call can ask: else it may hear of a service that is not up for as long as HEALTH_INTERVAL.
    let first = health_of(&context.readiness);
    report_health(first, &health).await;
    tokio::spawn(keep_reporting_health(context.readiness.clone(), health, first));
    let routes = Routes::new(health_service)
        .add_service(reflection)
        .add_service(reflection_v1alpha)
        .add_service(poses)
        .prepare();
    let admit = middleware::from_fn_with_state(Admitting::new(&context, limit), admit);
    Ok(routes.into_axum_router().layer(CatchPanicLayer::custom(panicked)).layer(admit))
}

fn reflection() -> tonic_reflection::server::Builder<'static> {
    tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(proto::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
}

/// Keeps the health service at what the probes say, until the program ends.
async fn keep_reporting_health(readiness: Readiness, health: HealthReporter, mut said: ServingStatus) {
    loop {
        tokio::time::sleep(HEALTH_INTERVAL).await;
        // Whoever watches hears of changes alone.
        let now = health_of(&readiness);
        if now != said {
            report_health(now, &health).await;
            said = now;
        }
    }
}

fn health_of(readiness: &Readiness) -> ServingStatus {
    if readiness.check().is_ok() { ServingStatus::Serving } else { ServingStatus::NotServing }
}

async fn report_health(status: ServingStatus, health: &HealthReporter) {
    for service in ["", PoseServiceServer::<Calls>::NAME] {
        health.set_service_status(service, status).await;
    }
}

fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response<Body> {
    drop(panic);
    tracing::error!("a handler panicked");
    Status::internal("the server failed on this request; its log has the details").into_http()
}
