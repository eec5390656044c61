//! Two instances that are restarted in turn, behind clients that follow readiness: nobody notices.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use posed::proto::EstimateRequest;
use posed::proto::estimate_request::Camera;
use posed::proto::pose_service_client::PoseServiceClient;
use reqwest::{Client, StatusCode};
use tokio::task::{JoinSet, block_in_place};
use tonic::transport::{Channel, Endpoint};

use crate::support::{Server, copy_of, read, samples};

const RESTARTS: usize = 10;
/// The delay is far longer than what clients know of readiness is old. The rest: slow machines have their time.
const FLAGS: [&str; 6] = ["--shutdown-delay-ms", "1500", "--timeout-ms", "60000", "--drain-seconds", "60"];
/// As with a load balancer that looks from time to time.
const OLD: Duration = Duration::from_millis(200);
const LIMIT: Duration = Duration::from_mins(1);

/// Where an instance is, whichever process it is just now.
struct Instance {
    addresses: [SocketAddr; 3],
    answered: AtomicUsize,
}

impl Instance {
    /// Each has an address of its own: nobody's outgoing connection takes a port while its process is away.
    fn start(host: [u8; 4], flags: &[&str]) -> (Self, Server) {
        let server = block_in_place(|| Server::start_on([SocketAddr::new(IpAddr::from(host), 0); 3], flags));
        (Self { addresses: [server.http, server.grpc, server.admin], answered: AtomicUsize::new(0) }, server)
    }

    async fn is_ready(&self) -> bool {
        let answer = Client::new().get(format!("http://{}/readyz", self.addresses[2])).send().await;
        answer.is_ok_and(|answer| answer.status().is_success())
    }

    /// Clients ask it as soon as it is ready.
    async fn until_it_has_answered_again(&self) {
        let before = self.answered.load(Ordering::Relaxed);
        let answer = async {
            while self.answered.load(Ordering::Relaxed) == before {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        tokio::time::timeout(LIMIT, answer).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn restarts_in_turn_lose_no_request() {
    // With one object they start quicker.
    let models = copy_of("models");
    for other in ["bracket", "link", "motor"] {
        std::fs::remove_dir_all(models.path().join(other)).unwrap();
    }
    let flags = [&FLAGS[..], &["--models", models.path().to_str().unwrap()]].concat();
    let (one, first) = Instance::start([127, 0, 0, 2], &flags);
    let (two, second) = Instance::start([127, 0, 0, 3], &flags);
    let (instances, mut servers) = (Arc::new([one, two]), [first, second]);
    let ended = Arc::new(AtomicBool::new(false));
    let mut clients = JoinSet::new();
    clients.spawn(client(Arc::clone(&instances), Arc::clone(&ended), Http::new(&instances)));
    clients.spawn(client(Arc::clone(&instances), Arc::clone(&ended), Http::new(&instances)));
    clients.spawn(client(Arc::clone(&instances), Arc::clone(&ended), Grpc::new(&instances)));
    for restart in 0..RESTARTS {
        let (instance, server) = (&instances[restart % 2], &mut servers[restart % 2]);
        instance.until_it_has_answered_again().await;
        server.signal("-TERM");
        assert!(block_in_place(|| server.wait(LIMIT)).success());
        *server = block_in_place(|| Server::start_on(instance.addresses, &flags));
    }
    ended.store(true, Ordering::Relaxed);
    let lost: Vec<String> = clients.join_all().await.into_iter().flatten().collect();
    let answered: Vec<_> = instances.iter().map(|instance| instance.answered.load(Ordering::Relaxed)).collect();
    println!("{RESTARTS} restarts, {answered:?} requests answered");
    assert!(lost.is_empty(), "{} lost: {lost:#?}", lost.len());
}

/// Sends one request to an instance; an error says what came instead of poses.
trait Ask: Send + 'static {
    fn ask(&mut self, instance: usize) -> impl Future<Output = Result<(), String>> + Send;
}

/// Asks the instances by turns, but only one that is ready, and retries nothing. Returns what went wrong.
async fn client(instances: Arc<[Instance; 2]>, ended: Arc<AtomicBool>, mut ask: impl Ask) -> Vec<String> {
    let mut lost = Vec::new();
    for turn in 0.. {
        if ended.load(Ordering::Relaxed) {
            break;
        }
        let mut chosen = None;
        for index in [turn % 2, (turn + 1) % 2] {
            if chosen.is_none() && instances[index].is_ready().await {
                chosen = Some(index);
            }
        }
        let Some(index) = chosen else {
            lost.push("no instance is ready".to_owned());
            continue;
        };
        tokio::time::sleep(OLD).await;
        match ask.ask(index).await {
            Ok(()) => drop(instances[index].answered.fetch_add(1, Ordering::Relaxed)),
            Err(error) => lost.push(format!("instance {index}: {error}")),
        }
    }
    lost
}

fn image() -> Bytes {
    read(&samples()[0].file).into()
}

/// With connections that it keeps.
struct Http {
    client: Client,
    urls: [String; 2],
    image: Bytes,
}

impl Http {
    fn new(instances: &[Instance; 2]) -> Self {
        let url = |instance: &Instance| format!("http://{}/v1/poses?camera=demo", instance.addresses[0]);
        Self { client: Client::new(), urls: [url(&instances[0]), url(&instances[1])], image: image() }
    }
}

impl Ask for Http {
    async fn ask(&mut self, instance: usize) -> Result<(), String> {
        let sent = self.client.post(&self.urls[instance]).body(self.image.clone()).send().await;
        let response = sent.map_err(|error| format!("{error:?}"))?;
        let status = response.status();
        let body = response.text().await.map_err(|error| format!("{error:?}"))?;
        if status == StatusCode::OK && body.contains("camera_from_object") {
            Ok(())
        } else {
            Err(format!("{status}: {body}"))
        }
    }
}

struct Grpc {
    clients: [PoseServiceClient<Channel>; 2],
    image: Bytes,
}

impl Grpc {
    fn new(instances: &[Instance; 2]) -> Self {
        let client = |instance: &Instance| {
            let endpoint = Endpoint::from_shared(format!("http://{}", instance.addresses[1])).unwrap();
            PoseServiceClient::new(endpoint.connect_lazy())
        };
        Self { clients: [client(&instances[0]), client(&instances[1])], image: image() }
    }
}

impl Ask for Grpc {
    async fn ask(&mut self, instance: usize) -> Result<(), String> {
        let camera = Some(Camera::CameraId("demo".into()));
        let request = EstimateRequest { image: self.image.clone(), camera, ..EstimateRequest::default() };
        let answer = self.clients[instance].estimate(request).await.map_err(|status| format!("{status:?}"))?;
        if answer.get_ref().poses.is_empty() { Err("no poses".into()) } else { Ok(()) }
    }
}
