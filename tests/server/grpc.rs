//! The gRPC interface.

use std::time::Duration;

use crate::support::{Server, read, samples};
use posed::proto::estimate_request::Camera;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{Camera as InlineCamera, EstimateRequest, Status, Transform};
use tonic::Code;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

async fn client(server: &Server) -> PoseServiceClient<Channel> {
    PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap()
}

fn pinhole(fx: f64) -> Camera {
    Camera::InlineCamera(InlineCamera { fx, fy: 600.0, cx: 319.5, cy: 239.5, ..InlineCamera::default() })
}

#[tokio::test]
async fn every_sample_is_answered_right() {
    let server = Server::start(&[]);
    let mut client = client(&server).await;
    for sample in samples() {
        for camera in [pinhole(600.0), Camera::CameraId("demo".into())] {
            let request = EstimateRequest {
                image: read(&sample.file).into(),
                camera: Some(camera),
                ..EstimateRequest::default()
            };
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
        let status = client
            .estimate(EstimateRequest { image: image.into(), camera, ..EstimateRequest::default() })
            .await
            .unwrap_err();
        assert_eq!(status.code(), code);
        assert!(status.message().contains(words), "{}", status.message());
    }
    let oversized = EstimateRequest {
        image: vec![0; 3_000_000].into(),
        camera: Some(pinhole(600.0)),
        ..EstimateRequest::default()
    };
    assert_eq!(client.estimate(oversized).await.unwrap_err().code(), Code::OutOfRange);
    let good = EstimateRequest { image: image.into(), camera: Some(pinhole(600.0)), ..EstimateRequest::default() };
    assert!(!client.estimate(good).await.unwrap().into_inner().poses.is_empty());
}

#[tokio::test]
async fn health_is_reported_for_the_service() {
    let server = Server::start(&[]);
    let channel = Channel::from_shared(format!("http://{}", server.grpc)).unwrap().connect().await.unwrap();
    let request = HealthCheckRequest { service: "posed.v1.PoseService".into() };
    let mut health = HealthClient::new(channel);
    let answer = health.check(request.clone()).await.unwrap().into_inner();
    assert_eq!(answer.status(), ServingStatus::Serving);
    // Whoever watches hears of changes alone.
    let mut watched = health.watch(request).await.unwrap().into_inner();
    assert_eq!(watched.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
    assert!(tokio::time::timeout(Duration::from_secs(2), watched.message()).await.is_err());
}

#[tokio::test]
async fn options_are_kept_and_bad_ones_refused() {
    let server = Server::start(&[]);
    let mut client = client(&server).await;
    let good = EstimateRequest {
        image: read(&samples()[0].file).into(),
        camera: Some(pinhole(600.0)),
        objects: vec!["cube".into()],
        max_instances: Some(1),
        captured_at: "frame 7".into(),
        world_from_camera: Some(Transform { rotation_w: 1.0, translation_x_m: 10.0, ..Transform::default() }),
        ..EstimateRequest::default()
    };
    let answer = client.estimate(good.clone()).await.unwrap().into_inner();
    assert_eq!((answer.poses.len(), answer.captured_at.as_str()), (1, "frame 7"));
    assert!(["cpu", "openvino"].contains(&answer.models.unwrap().provider.as_str()));
    let solved = answer.poses[0].solved.as_ref().unwrap();
    let x = |transform: Option<Transform>| transform.unwrap().translation_x_m;
    let world = solved.world_from_object.as_ref().unwrap();
    assert!((x(world.transform) - x(solved.camera_from_object) - 10.0).abs() < 1e-9);
    assert_eq!(world.covariance, solved.covariance);

    let bent = InlineCamera { fx: 600.0, fy: 600.0, distortion: vec![0.1; 3], model: 2, ..InlineCamera::default() };
    for (request, code, words) in [
        (EstimateRequest { objects: vec!["teapot".into()], ..good.clone() }, Code::NotFound, "known objects"),
        (EstimateRequest { min_confidence: f64::NAN, ..good.clone() }, Code::InvalidArgument, "min_confidence"),
        (
            EstimateRequest { camera: Some(Camera::InlineCamera(bent)), ..good.clone() },
            Code::InvalidArgument,
            "4, 5, 8, 12 or 14",
        ),
        (
            EstimateRequest { base_from_camera: Some(Transform::default()), ..good.clone() },
            Code::InvalidArgument,
            "base_from_camera",
        ),
    ] {
        let status = client.estimate(request).await.unwrap_err();
        assert!(status.code() == code && status.message().contains(words), "{status}");
    }
    let mut hurried = tonic::Request::new(good);
    hurried.set_timeout(std::time::Duration::from_millis(1));
    assert!(matches!(client.estimate(hurried).await.unwrap_err().code(), Code::DeadlineExceeded | Code::Cancelled));
}
