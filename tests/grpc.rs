//! The gRPC interface of the real server, with the shipped models.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod support;

use posed::proto::estimate_request::Camera;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{EstimateRequest, PinholeCamera, Status};
use support::{Server, read, samples};
use tonic::Code;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

async fn client(server: &Server) -> PoseServiceClient<Channel> {
    PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap()
}

fn pinhole(fx: f64) -> Camera {
    Camera::Pinhole(PinholeCamera { fx, fy: 600.0, cx: 319.5, cy: 239.5 })
}

#[tokio::test]
async fn every_sample_is_answered_right() {
    let server = Server::start(&[]);
    let mut client = client(&server).await;
    for sample in samples() {
        for camera in [pinhole(600.0), Camera::CameraId("demo".into())] {
            let request = EstimateRequest { image: read(&sample.file), camera: Some(camera) };
            let answer = client.estimate(request).await.unwrap().into_inner();
            for known in &sample.objects {
                let found = answer.poses.iter().find(|pose| pose.object == known.object).unwrap();
                assert_ne!(found.status(), Status::Rejected);
                let solved = found.solved.as_ref().unwrap();
                let t = solved.camera_from_object.unwrap();
                let error = known.error(
                    [t.rotation_x, t.rotation_y, t.rotation_z, t.rotation_w],
                    [t.translation_x_m, t.translation_y_m, t.translation_z_m],
                );
                assert!(error < 0.1, "{} {}: {error:.3}", sample.file.display(), known.object);
                assert_eq!(solved.covariance.len(), 36);
            }
        }
    }
}

#[tokio::test]
async fn bad_requests_have_their_codes_and_the_next_good_one_works() {
    let server = Server::start(&["--max-body-bytes", "2000000"]);
    let mut client = client(&server).await;
    let image = read(&samples()[0].file);
    let cases = [
        (Vec::new(), Some(pinhole(600.0)), Code::InvalidArgument, "empty"),
        (image[..image.len() / 2].to_vec(), Some(pinhole(600.0)), Code::InvalidArgument, "truncated"),
        (image.clone(), None, Code::InvalidArgument, "no camera"),
        (image.clone(), Some(pinhole(f64::NAN)), Code::InvalidArgument, "'fx'"),
        (image.clone(), Some(Camera::CameraId("nowhere".into())), Code::NotFound, "known cameras: demo"),
    ];
    for (image, camera, code, words) in cases {
        let status = client.estimate(EstimateRequest { image, camera }).await.unwrap_err();
        assert_eq!(status.code(), code);
        assert!(status.message().contains(words), "{}", status.message());
    }
    let oversized = EstimateRequest { image: vec![0; 3_000_000], camera: Some(pinhole(600.0)) };
    assert_eq!(client.estimate(oversized).await.unwrap_err().code(), Code::OutOfRange);
    let good = EstimateRequest { image, camera: Some(pinhole(600.0)) };
    assert!(!client.estimate(good).await.unwrap().into_inner().poses.is_empty());
}

#[tokio::test]
async fn health_is_reported_for_the_service() {
    let server = Server::start(&[]);
    let channel = Channel::from_shared(format!("http://{}", server.grpc)).unwrap().connect().await.unwrap();
    let request = HealthCheckRequest { service: "posed.v1.PoseService".into() };
    let answer = HealthClient::new(channel).check(request).await.unwrap().into_inner();
    assert_eq!(answer.status(), ServingStatus::Serving);
}
