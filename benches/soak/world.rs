//! What all clients share: where the server is, what they send it, and the book of what comes of it.

use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use posed::proto::pose_service_client::PoseServiceClient;
use tokio::task::JoinSet;
use tonic::transport::{Channel, Endpoint};

use crate::book::{Book, Outcome, Row};
use crate::poses::Poses;
use crate::process::Server;

pub struct World {
    pub book: Arc<Book>,
    pub material: Arc<Material>,
    pub http: SocketAddr,
    pub grpc: SocketAddr,
    /// With connections that it keeps.
    pub client: reqwest::Client,
    pub poses: PoseServiceClient<Channel>,
}

/// What is sent.
pub struct Material {
    pub samples: Vec<Sample>,
    /// 24 megapixels of one colour in few bytes.
    pub bomb: Bytes,
    /// More than a body may have.
    pub zeros: Bytes,
}

pub struct Sample {
    pub jpeg: Bytes,
    /// RGB.
    pub raw: Bytes,
    pub width: u32,
    pub height: u32,
    pub poses: Poses,
}

impl Material {
    pub async fn read(server: &Server) -> Self {
        let mut samples = Vec::new();
        for number in 1..=3 {
            let jpeg = std::fs::read(format!("samples/sample-{number}.jpg")).unwrap();
            let poses = Poses::of_json(&server.post(jpeg.clone()).await);
            assert!(!poses.is_empty(), "sample {number} has no poses");
            let image = image::load_from_memory(&jpeg).unwrap().into_rgb8();
            let (width, height) = image.dimensions();
            samples.push(Sample { jpeg: jpeg.into(), raw: image.into_raw().into(), width, height, poses });
        }
        let mut bomb = std::io::Cursor::new(Vec::new());
        let plain = image::RgbImage::from_pixel(8192, 2929, image::Rgb([9; 3]));
        plain.write_to(&mut bomb, image::ImageFormat::Png).unwrap();
        Self { samples, bomb: bomb.into_inner().into(), zeros: vec![0; 20 << 20].into() }
    }

    pub fn sample(&self, round: usize) -> &Sample {
        &self.samples[round % self.samples.len()]
    }
}

impl World {
    pub fn new(server: &Server, material: &Arc<Material>, book: &Arc<Book>) -> Arc<Self> {
        Arc::new(Self {
            book: Arc::clone(book),
            material: Arc::clone(material),
            http: server.http,
            grpc: server.grpc,
            client: reqwest::Client::new(),
            poses: PoseServiceClient::new(channel(server.grpc)),
        })
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.http)
    }

    /// A connection that nobody else uses.
    pub fn own_poses(&self) -> PoseServiceClient<Channel> {
        PoseServiceClient::new(channel(self.grpc))
    }
}

fn channel(address: SocketAddr) -> Channel {
    Endpoint::from_shared(format!("http://{address}")).unwrap().connect_lazy()
}

type Act = dyn Fn(Arc<World>, usize) -> Pin<Box<dyn Future<Output = Outcome> + Send>> + Send + Sync;

/// Somebody who does one thing again and again.
pub struct Client {
    row: Row,
    pause: Duration,
    act: Box<Act>,
}

/// As a refusal asks for with `Retry-After`.
const RETRY_AFTER: Duration = Duration::from_secs(1);
/// Longer than the server lets anybody wait.
const PATIENCE: Duration = Duration::from_secs(90);

impl Client {
    /// An act gets the number of its round.
    pub fn new<F, A>(row: Row, pause: Duration, act: F) -> Self
    where
        F: Fn(Arc<World>, usize) -> A + Send + Sync + 'static,
        A: Future<Output = Outcome> + Send + 'static,
    {
        Self { row, pause, act: Box::new(move |world, round| Box::pin(act(world, round))) }
    }

    /// Until then; what has begun is brought to its end.
    async fn run(self, world: Arc<World>, end: Instant) {
        for round in 0.. {
            if Instant::now() > end {
                return;
            }
            let acted = tokio::time::timeout(PATIENCE, (self.act)(Arc::clone(&world), round)).await;
            let outcome = acted.unwrap_or_else(|_| Outcome::Lost(format!("no end after {PATIENCE:?}")));
            let again = matches!(outcome, Outcome::Refused(_));
            world.book.note(self.row, outcome);
            // Not in step with each other.
            let pause = self.pause.mul_f64(0.5 + fastrand::f64());
            tokio::time::sleep(if again { RETRY_AFTER } else { pause }).await;
        }
    }
}

/// All of them at once.
pub async fn run(world: &Arc<World>, clients: Vec<Client>, time: Duration) {
    let end = Instant::now() + time;
    let tasks: JoinSet<()> = clients.into_iter().map(|client| client.run(Arc::clone(world), end)).collect();
    tasks.join_all().await;
}
