//! `EstimateStream`, and what clients ask a gRPC server about itself.

use posed::proto::estimate_request::Camera;
use posed::proto::estimate_stream_request::Kind;
use posed::proto::estimate_stream_response::Result as FrameResult;
use posed::proto::pose_service_client::PoseServiceClient;
use posed::proto::{
    EstimateRequest, EstimateStreamRequest, EstimateStreamResponse, Frame, ListObjectsRequest, StreamSettings,
};
use tonic::transport::Channel;
use tonic::{Code, Streaming};

use crate::support::{Server, read, samples};

async fn client(server: &Server) -> PoseServiceClient<Channel> {
    PoseServiceClient::connect(format!("http://{}", server.grpc)).await.unwrap()
}

fn frame(frame_id: u64, image: Vec<u8>) -> EstimateStreamRequest {
    let request = EstimateRequest {
        image: image.into(),
        camera: Some(Camera::CameraId("demo".into())),
        ..EstimateRequest::default()
    };
    EstimateStreamRequest { kind: Some(Kind::Frame(Frame { frame_id, request: Some(request), capture_time: None })) }
}

fn settings(latest_only: bool, window: u32) -> EstimateStreamRequest {
    EstimateStreamRequest {
        kind: Some(Kind::Settings(StreamSettings { latest_only, window, ..StreamSettings::default() })),
    }
}

async fn stream(server: &Server, requests: Vec<EstimateStreamRequest>) -> Streaming<EstimateStreamResponse> {
    client(server).await.estimate_stream(futures::stream::iter(requests)).await.unwrap().into_inner()
}

/// Frame ids with the code of each: 0 where there is an answer with poses.
async fn collect(mut responses: Streaming<EstimateStreamResponse>) -> Vec<(u64, i32)> {
    let mut all = Vec::new();
    while let Some(response) = responses.message().await.unwrap() {
        let code = match response.result.unwrap() {
            FrameResult::Answer(answer) => -i32::from(answer.poses.is_empty()),
            FrameResult::Error(error) => error.code,
        };
        all.push((response.frame_id, code));
    }
    all
}

#[tokio::test]
async fn every_frame_is_answered_and_a_bad_one_does_not_end_the_stream() {
    let server = Server::start(&[]);
    let images: Vec<Vec<u8>> = samples().iter().map(|sample| read(&sample.file)).collect();
    let mut requests = vec![settings(false, 2)];
    requests.extend((0..6).map(|id| frame(id, images[usize::try_from(id).unwrap() % images.len()].clone())));
    requests.insert(4, frame(99, b"no image".to_vec()));
    let mut answered = collect(stream(&server, requests).await).await;
    answered.sort_unstable();
    let bad = Code::InvalidArgument as i32;
    assert_eq!(answered, [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (5, 0), (99, bad)]);
}

/// A camera that sends faster than the server answers: the first and the last frame are answered, others replaced, and
/// each is told.
#[tokio::test]
async fn of_waiting_frames_only_the_latest_is_worked_on() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let frames = (0..20).map(|id| frame(id, image.clone()));
    let requests = std::iter::once(settings(true, 0)).chain(frames).collect();
    let mut answered = collect(stream(&server, requests).await).await;
    answered.sort_unstable();
    assert_eq!(answered.len(), 20);
    let replaced = answered.iter().filter(|(_, code)| *code == Code::Aborted as i32).count();
    assert!(replaced >= 10, "{answered:?}");
    assert_eq!((answered[0].1, answered[19]), (0, (19, 0)));
}

#[tokio::test]
async fn bad_streams_are_refused() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    for (requests, words) in [
        (vec![settings(false, 17)], "'window' is 17"),
        (vec![frame(1, image.clone()), settings(false, 2)], "before the first frame"),
        (vec![EstimateStreamRequest { kind: None }], "neither"),
    ] {
        let mut responses = stream(&server, requests).await;
        let status = loop {
            match responses.message().await {
                Ok(Some(_)) => {}
                Ok(None) => panic!("the stream ended well"),
                Err(status) => break status,
            }
        };
        assert_eq!(status.code(), Code::InvalidArgument);
        assert!(status.message().contains(words), "{}", status.message());
    }
    assert_eq!(collect(stream(&server, vec![frame(7, image)]).await).await, [(7, 0)]);
}

#[tokio::test]
async fn objects_are_listed() {
    let server = Server::start(&[]);
    let objects = client(&server).await.list_objects(ListObjectsRequest {}).await.unwrap().into_inner().objects;
    let cube = objects.iter().find(|object| object.name == "cube").unwrap();
    assert!(cube.calibrated && cube.keypoints == 14 && cube.diameter_m > 0.05);
}

#[tokio::test]
async fn the_protocol_can_be_asked_for() {
    use tonic_reflection::pb::v1::ServerReflectionRequest;
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

    let server = Server::start(&[]);
    let channel = Channel::from_shared(format!("http://{}", server.grpc)).unwrap().connect().await.unwrap();
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut answers = ServerReflectionClient::new(channel)
        .server_reflection_info(futures::stream::iter([request]))
        .await
        .unwrap()
        .into_inner();
    let Some(MessageResponse::ListServicesResponse(list)) = answers.message().await.unwrap().unwrap().message_response
    else {
        panic!("no list of services")
    };
    let names: Vec<&str> = list.service.iter().map(|service| service.name.as_str()).collect();
    assert!(names.contains(&"posed.v1.PoseService") && names.contains(&"grpc.health.v1.Health"), "{names:?}");
}

/// A stream that never ends does not hold up a shutdown, and its client is told.
#[tokio::test]
async fn a_shutdown_ends_streams() {
    let mut server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let (sender, requests) = tokio::sync::mpsc::channel(4);
    let requests = tokio_stream::wrappers::ReceiverStream::new(requests);
    sender.send(frame(1, image)).await.unwrap();
    let mut responses = client(&server).await.estimate_stream(requests).await.unwrap().into_inner();
    assert_eq!(responses.message().await.unwrap().unwrap().frame_id, 1);
    server.signal("-TERM");
    assert_eq!(responses.message().await.unwrap_err().code(), Code::Unavailable);
    assert!(server.wait(std::time::Duration::from_secs(20)).success());
}
