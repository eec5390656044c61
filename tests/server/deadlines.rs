//! Callers with little time.

use std::time::Duration;

use reqwest::{Client, StatusCode};

use crate::raw_grpc::RawClient;
use crate::support::{CAMERA, Server, assert_still_works, error, json, metrics, post, read, samples};

/// Many callers whose times are mostly too short for the queue before them: what cannot be in time is refused instead of
/// worked on, so that most of the work is for answers.
#[tokio::test(flavor = "multi_thread")]
async fn hasty_callers_leave_the_work_to_what_can_be_in_time() {
    let server = Server::start(&[]);
    let image = read(&samples()[0].file);
    let mut took = 0.0;
    for _ in 0..3 {
        took = json(post(&server, CAMERA, image.clone()).await).await["timings_ms"]["total"].as_f64().unwrap();
    }
    let url = server.url(&format!("/v1/poses?{CAMERA}"));
    let clients = (0..16).map(|client| {
        let time = format!("{:.0}", (took * f64::from(client + 1) / 3.0).max(1.0));
        let (url, image) = (url.clone(), image.clone());
        tokio::spawn(async move {
            let (http, mut outcomes) = (Client::new(), Vec::new());
            for _ in 0..10 {
                let request = http.post(&url).header("x-request-timeout-ms", &time).body(image.clone());
                let response = request.send().await.unwrap();
                let status = response.status();
                outcomes.push(status);
                if status == StatusCode::TOO_MANY_REQUESTS {
                    assert_eq!(error(response).await.0, "queue_full");
                    tokio::time::sleep(Duration::from_millis(50)).await;
                }
            }
            outcomes
        })
    });
    let outcomes: Vec<StatusCode> =
        futures::future::join_all(clients).await.into_iter().flat_map(Result::unwrap).collect();
    let count = |status: StatusCode| outcomes.iter().filter(|outcome| **outcome == status).count();
    let (answered, busy, late) =
        (count(StatusCode::OK), count(StatusCode::TOO_MANY_REQUESTS), count(StatusCode::GATEWAY_TIMEOUT));
    assert_eq!(answered + busy + late, outcomes.len());
    assert!(answered > 0 && busy > 0, "{answered} answered, {busy} refused, {late} late");
    let text = metrics(&server).await;
    let left = |reason: &str| {
        let line = format!("posed_queue_dequeued_total{{reason=\"{reason}\"}} ");
        text.lines().find_map(|found| found.strip_prefix(&line)).unwrap().parse::<f64>().unwrap()
    };
    let (worked, expired) = (left("worked"), left("expired"));
    println!("{answered} answered, {busy} busy, {late} late; {worked} worked on, {expired} expired");
    assert!(worked > 2.0 * expired, "{worked} images were worked on, {expired} expired in the queue\n{text}");
    assert_still_works(&server).await;
}

/// A call's time runs while its message comes, too.
#[tokio::test]
async fn a_call_that_is_still_being_sent_at_its_deadline_is_told_so_and_counted() {
    let server = Server::start(&["--body-timeout-ms", "60000"]);
    let mut client = RawClient::connect(&server).await;
    let mut call = client.call("Estimate", &[("grpc-timeout", "200m")]).await;
    call.upload.send_data(vec![0, 0, 1, 0, 0, 1, 2, 3].into(), false).unwrap();
    assert_eq!(call.refused().await.0, "4");
    server.until_counted("posed_requests_total{protocol=\"grpc\",route=\"Estimate\",outcome=\"timed_out\"} 1").await;
    // A stream has as long as it asks for.
    let stream = client.call("EstimateStream", &[("grpc-timeout", "200m")]).await;
    let (head, mut body) = stream.answer().await.into_parts();
    assert_eq!(head.status, 200);
    assert!(body.data().await.is_none());
    assert_eq!(body.trailers().await.unwrap().unwrap()["grpc-status"], "4");
    let counted = "posed_requests_total{protocol=\"grpc\",route=\"EstimateStream\",outcome=\"timed_out\"} 1";
    server.until_counted(counted).await;
    assert_still_works(&server).await;
}

/// Bytes that come one by one are no pause; the message has a time limit all the same.
#[tokio::test]
async fn a_message_that_drips_is_cut_off() {
    let server = Server::start(&["--timeout-ms", "5000"]);
    let mut client = RawClient::connect(&server).await;
    for method in ["Estimate", "EstimateStream"] {
        let mut call = client.call(method, &[]).await;
        call.upload.send_data(vec![0, 0, 1, 0, 0].into(), false).unwrap();
        let mut drips = 0;
        // Until the server resets the call.
        while call.upload.send_data(vec![7].into(), false).is_ok() {
            drips += 1;
            assert!(drips < 2000, "{method} goes on for ever");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let counted = format!("route=\"{method}\",outcome=\"timed_out\"}} 1");
        server.until_counted(&counted).await;
    }
    assert_still_works(&server).await;
}
