//! Runs the real program on the shipped models.
#![allow(dead_code, unreachable_pub, reason = "each test file uses a part of this")]

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Read as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use posed::evaluation::{ModelPoints, ObjectMesh};
use posed_core::geometry::Pose;
use serde::Deserialize;
use serde_json::Value;

pub const CAMERA: &str = "fx=600&fy=600&cx=319.5&cy=239.5";
pub const FREE_PORTS: [&str; 6] = ["--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0", "--admin", "127.0.0.1:0"];
const START_LIMIT: Duration = Duration::from_mins(1);

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The program, run in the repository so that it finds models, references and ONNX Runtime where users have them.
pub fn posed(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_posed"));
    command.current_dir(root()).args(arguments);
    command
}

pub fn run(arguments: &[&str]) -> Output {
    posed(arguments).output().unwrap()
}

/// A failed run's one line of explanation.
pub fn explanation(output: &Output) -> String {
    assert!(!output.status.success(), "should have failed");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!stderr.contains("panicked"), "{stderr}");
    stderr
}

/// `serve` refuses to start, with these words.
pub fn refuses_to_serve(arguments: &[&str], words: &str) {
    let said = explanation(&run(&[&["serve"], &FREE_PORTS[..], arguments].concat()));
    assert!(said.contains(words), "{said}");
}

/// A running server on free ports, killed when dropped.
pub struct Server {
    child: Child,
    log: Arc<Mutex<String>>,
    pub http: SocketAddr,
    pub grpc: SocketAddr,
    pub admin: SocketAddr,
}

impl Server {
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = posed(&["serve", "--cameras", "samples"]);
        command.args(FREE_PORTS).args(arguments);
        Self::run(command)
    }

    /// A server with another address for HTTP.
    pub fn start_at(http: &str) -> Self {
        Self::run(posed(&["serve", "--http", http, "--grpc", "127.0.0.1:0", "--admin", "127.0.0.1:0"]))
    }

    /// A server with these addresses for HTTP, gRPC and operators.
    pub fn start_on(addresses: [SocketAddr; 3], arguments: &[&str]) -> Self {
        let mut command = posed(&["serve", "--cameras", "samples"]);
        for (flag, address) in ["--http", "--grpc", "--admin"].into_iter().zip(addresses) {
            command.args([flag, &address.to_string()]);
        }
        command.args(arguments);
        Self::run(command)
    }

    /// A server that may open so many files.
    pub fn start_with_files(files: u32, arguments: &[&str]) -> Self {
        let mut command = Command::new("sh");
        let limit = format!("ulimit -n {files} && exec \"$0\" \"$@\"");
        command.current_dir(root()).args(["-c", &limit, env!("CARGO_BIN_EXE_posed"), "serve", "--cameras", "samples"]);
        command.args(FREE_PORTS).args(arguments);
        Self::run(command)
    }

    fn run(mut command: Command) -> Self {
        // Tests of queues and deadlines count on one.
        command.env("POSED_WORKERS", "1");
        let mut child = command.env("NO_COLOR", "1").stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut seen = String::new();
        let mut address = |protocol: &str| {
            let start = Instant::now();
            loop {
                assert!(start.elapsed() < START_LIMIT, "no '{protocol} on' line: {seen}");
                let Some(Ok(line)) = lines.next() else { panic!("the server ended: {seen}") };
                seen.push_str(&line);
                seen.push('\n');
                if let Some((_, address)) = line.split_once(&format!("{protocol} on ")) {
                    // In JSON the message ends with a quote.
                    return address.split('"').next().unwrap().trim().parse().unwrap();
                }
            }
        };
        let (admin, http, grpc) = (address("admin"), address("http"), address("grpc"));
        let mut is_ready = false;
        for line in lines.by_ref().map_while(Result::ok) {
            is_ready = line.contains("ready after");
            seen.push_str(&line);
            seen.push('\n');
            if is_ready {
                break;
            }
        }
        assert!(is_ready, "the server ended: {seen}");
        // Someone must go on reading, or the server would block on a full pipe.
        let log = Arc::new(Mutex::new(seen));
        let of_reader = Arc::clone(&log);
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let mut log = of_reader.lock().unwrap();
                log.push_str(&line);
                log.push('\n');
            }
        });
        Self { child, log, http, grpc, admin }
    }

    /// What it has logged so far.
    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// Waits until its log has some words.
    pub async fn until_logged(&self, words: &str) {
        self.until(words, async || self.log()).await;
    }

    /// Waits until its metrics have some words.
    pub async fn until_counted(&self, words: &str) {
        self.until(words, async || metrics(self).await).await;
    }

    async fn until(&self, words: &str, look: impl AsyncFn() -> String) {
        let start = Instant::now();
        loop {
            let text = look().await;
            if text.contains(words) {
                return;
            }
            assert!(start.elapsed() < START_LIMIT, "{words:?} is not in\n{text}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.http)
    }

    pub fn admin_url(&self, path: &str) -> String {
        format!("http://{}{path}", self.admin)
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, signal: &str) {
        let status = Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap();
        assert!(status.success());
    }

    pub fn wait(&mut self, limit: Duration) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < limit, "the server did not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A sample image with what is known of it.
pub struct Sample {
    pub file: PathBuf,
    pub objects: Vec<KnownObject>,
}

#[derive(Deserialize)]
pub struct KnownObject {
    pub object: String,
    obj_id: u32,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
}

pub fn samples() -> Vec<Sample> {
    let text = std::fs::read_to_string(root().join("samples/poses.json")).unwrap();
    let images: BTreeMap<String, Vec<KnownObject>> = serde_json::from_str(&text).unwrap();
    let samples = images.into_iter().map(|(name, objects)| Sample { file: root().join("samples").join(name), objects });
    samples.collect()
}

impl KnownObject {
    /// In the camera's frame, or the rig's.
    pub fn pose(&self) -> Pose {
        Pose::from_quaternion_xyzw(self.rotation_xyzw, self.translation_m).unwrap()
    }

    /// ADD of an answer over the object's diameter.
    pub fn error(&self, rotation_xyzw: [f64; 4], translation_m: [f64; 3]) -> f64 {
        let model = ObjectMesh::read(&root().join("training/demo/models"), self.obj_id).unwrap();
        let truth = self.pose();
        let answer = Pose::from_quaternion_xyzw(rotation_xyzw, translation_m).unwrap();
        let points = ModelPoints::new(&model).unwrap();
        points.average_distance_m(&answer, &truth) / points.diameter_m()
    }
}

/// Checks an answer's JSON against what is known of the image: right is within a tenth of the diameter.
pub fn assert_right(sample: &Sample, answer: &Value) {
    assert_within(sample, answer, 0.1);
}

pub fn assert_within(sample: &Sample, answer: &Value, limit: f64) {
    for known in &sample.objects {
        let poses = answer["poses"].as_array().unwrap();
        let found: Vec<_> = poses.iter().filter(|pose| pose["object"] == known.object.as_str()).collect();
        let best = found.first().unwrap_or_else(|| panic!("{}: no {}", sample.file.display(), known.object));
        let transform = &best["camera_from_object"];
        let rotation = serde_json::from_value(transform["rotation_xyzw"].clone()).unwrap();
        let translation = serde_json::from_value(transform["translation_m"].clone()).unwrap();
        let error = known.error(rotation, translation);
        assert!(error < limit, "{} {}: {error:.3} of the diameter", sample.file.display(), known.object);
        assert_ne!(best["status"], "rejected");
    }
}

/// A copy of a folder of the repository that a test may damage.
pub fn copy_of(folder: &str) -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    let mut pending = vec![(root().join(folder), copy.path().to_path_buf())];
    while let Some((from, to)) = pending.pop() {
        std::fs::create_dir_all(&to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            let target = to.join(path.file_name().unwrap());
            if path.is_dir() {
                pending.push((path, target));
            } else {
                std::fs::copy(path, target).unwrap();
            }
        }
    }
    copy
}

/// Changes a JSON file.
pub fn change(path: &Path, change: impl FnOnce(&mut Value)) {
    let mut json: Value = serde_json::from_slice(&read(path)).unwrap();
    change(&mut json);
    std::fs::write(path, json.to_string()).unwrap();
}

pub fn read(path: &Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    std::fs::File::open(path).unwrap().read_to_end(&mut bytes).unwrap();
    bytes
}

/// An answer's body as JSON.
pub async fn json(response: reqwest::Response) -> Value {
    serde_json::from_slice(&response.bytes().await.unwrap()).unwrap()
}

/// An error's code and sentence.
pub async fn error(response: reqwest::Response) -> (String, String) {
    let answer = json(response).await;
    let text = |field: &str| answer["error"][field].as_str().unwrap().to_owned();
    (text("code"), text("message"))
}

/// What `/metrics` says.
pub async fn metrics(server: &Server) -> String {
    reqwest::get(server.admin_url("/metrics")).await.unwrap().text().await.unwrap()
}

/// Posts an image.
pub async fn post(server: &Server, query: &str, body: Vec<u8>) -> reqwest::Response {
    let url = server.url(&format!("/v1/poses?{query}"));
    reqwest::Client::new().post(url).body(body).send().await.unwrap()
}

/// The server still answers the first sample right.
pub async fn assert_still_works(server: &Server) {
    let sample = &samples()[0];
    let response = post(server, CAMERA, read(&sample.file)).await;
    assert_eq!(response.status(), 200);
    assert_right(sample, &json(response).await);
}

/// The half of the first sample about its cube, twice side by side.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a pixel of a small image")]
pub fn two_cubes() -> Vec<u8> {
    let sample = &samples()[0];
    let [x, _, z] = sample.objects.iter().find(|known| known.object == "cube").unwrap().translation_m;
    let left = (600.0 * x / z + 319.5 - 160.0).clamp(0.0, 320.0) as u32;
    let image = image::open(&sample.file).unwrap().into_rgb8();
    png(&image::RgbImage::from_fn(640, 480, |x, y| *image.get_pixel(left + x % 320, y)).into())
}

/// An image as a PNG file.
pub fn png(image: &image::DynamicImage) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// The bundled scene that three cameras see: images in the order of the rig `scene`, and what is known of it in the rig's
/// frame.
pub fn scene() -> (Vec<Vec<u8>>, Vec<KnownObject>) {
    let images = (1..=3).map(|view| read(&root().join(format!("samples/scene/view-{view}.jpg")))).collect();
    let objects = serde_json::from_slice(&read(&root().join("samples/scene/poses.json"))).unwrap();
    (images, objects)
}

/// Where its cameras see one of its objects: `camera_from_object`, in the order of the images.
pub fn scene_poses(object: &str) -> Vec<Pose> {
    let world_from_object = scene().1.iter().find(|known| known.object == object).unwrap().pose();
    let seen = |camera: &Value| {
        let rotation = serde_json::from_value(camera["rotation_xyzw"].clone()).unwrap();
        let translation = serde_json::from_value(camera["translation_m"].clone()).unwrap();
        Pose::from_quaternion_xyzw(rotation, translation).unwrap().inverse() * world_from_object
    };
    scene_cameras().iter().map(seen).collect()
}

/// `rig_from_camera` of its cameras.
pub fn scene_cameras() -> Vec<Value> {
    let rig: Value = serde_json::from_slice(&read(&root().join("samples/scene.rig.json"))).unwrap();
    rig["cameras"].as_array().unwrap().iter().map(|camera| camera["rig_from_camera"].clone()).collect()
}

/// Checks that each object of the bundled scene is answered once, `ok` and right: within a share of its diameter.
pub fn assert_scene_right(answer: &Value, limit: f64) {
    let objects = answer["objects"].as_array().unwrap();
    for known in scene().1 {
        // What is rejected is a false detection in one of the views.
        let is_it = |object: &&Value| object["object"] == known.object.as_str() && object["status"] != "rejected";
        let found: Vec<_> = objects.iter().filter(is_it).collect();
        assert_eq!(found.len(), 1, "{}: {objects:#?}", known.object);
        let transform = &found[0]["world_from_object"];
        let rotation = serde_json::from_value(transform["rotation_xyzw"].clone()).unwrap();
        let translation = serde_json::from_value(transform["translation_m"].clone()).unwrap();
        let error = known.error(rotation, translation);
        assert!(error < limit, "{}: {error:.3} of the diameter", known.object);
        assert_eq!(found[0]["status"], "ok", "{}", found[0]);
    }
}
