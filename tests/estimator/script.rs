//! A model folder of one object, networks that do what a test says, and an image that shows a known pose.

#![allow(unreachable_pub, reason = "for the other modules of this test")]

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};

use image::RgbImage;
use nalgebra::{Vector2, Vector3};
use posed::estimator::Estimator;
use posed::model::{
    Backend, Input, Library, LoadError, LoadOptions, Network, Output, Outputs, Provider, ProviderSetting, References,
    Runtime, RuntimeError,
};
use posed_core::geometry::{Camera, Pose};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

/// Side of the crops, and of the detector's input (the image fits without scaling).
pub const CROP: u32 = 64;
pub const WIDTH: u32 = 320;
pub const HEIGHT: u32 = 256;
/// x, y, width, height of the box that the detector sees.
pub const BOX: [f64; 4] = [100.0, 60.0, 90.0, 110.0];
/// Side of a crop over that of its box.
pub const SCALE: f64 = 1.5;
const SIDE_M: f64 = 0.06;

type Answer = dyn Fn(Input<'_>) -> Result<Vec<Output>, RuntimeError> + Send + Sync;

/// Networks that answer as they are told.
#[derive(Clone)]
pub struct Script {
    pub detector: Arc<Answer>,
    pub keypoints: Arc<Answer>,
    /// Networks loaded so far.
    pub loads: Arc<AtomicUsize>,
}

impl Default for Script {
    fn default() -> Self {
        Self {
            detector: Arc::new(|_| Ok(vec![end2end()])),
            keypoints: Arc::new(|input| Ok(keypoints(batch_of(input)))),
            loads: Arc::default(),
        }
    }
}

struct Scripted(Arc<Answer>);

impl Network for Scripted {
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError> {
        Ok(Outputs { network: "scripted".into(), tensors: (self.0)(input)?, others: Vec::new() })
    }
}

impl Backend for Script {
    fn load(&self, _: &str, bytes: &[u8], _: LoadOptions<'_>) -> Result<Box<dyn Network>, RuntimeError> {
        self.loads.fetch_add(1, Ordering::Relaxed);
        let answer = if bytes == b"detector" { &self.detector } else { &self.keypoints };
        Ok(Box::new(Scripted(Arc::clone(answer))))
    }

    fn provider(&self) -> Provider {
        Provider::Cpu
    }
}

/// The two manifests of a model folder, without hashes.
#[derive(Clone)]
pub struct Manifests {
    pub detector: Value,
    pub object: Value,
}

impl Default for Manifests {
    fn default() -> Self {
        Self {
            detector: json!({
                "format": "end2end", "labels": ["block"], "score_threshold": 0.5,
                "input": {"layout": "nhwc", "dtype": "uint8", "width": WIDTH, "height": HEIGHT, "fill": 0},
            }),
            object: json!({
                "name": "block", "obj_id": 1, "diameter_m": 0.1,
                "virtual_keypoints_m": corners().map(|corner| [corner.x, corner.y, corner.z]),
                "crop_scale": SCALE, "input": {"layout": "nhwc", "dtype": "uint8", "size": CROP},
                "output": {"kind": "keypoints"}, "covariance_scale": vec![1.0; 8],
            }),
        }
    }
}

/// What makes estimators of a model folder.
pub struct Models {
    library: Arc<Library>,
    references: Arc<References>,
    script: Script,
}

/// ONNX Runtime: there is one for each process.
pub fn runtime() -> &'static Runtime {
    static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::load(ProviderSetting::Auto, 2).unwrap());
    &RUNTIME
}

/// The files of the two networks.
pub struct Networks<'a> {
    pub detector: &'a [u8],
    pub keypoints: &'a [u8],
}

/// Scripts tell them apart by these bytes.
const SCRIPTED: Networks<'_> = Networks { detector: b"detector", keypoints: b"keypoints" };

/// Writes a model folder with the object's reference in it.
pub fn write_models(folder: &Path, manifests: &Manifests, networks: &Networks<'_>) {
    let write = |file: &str, bytes: &[u8]| {
        let path = folder.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    };
    let Manifests { mut detector, mut object } = manifests.clone();
    detector["model_sha256"] = sha256(networks.detector).into();
    object["model_sha256"] = sha256(networks.keypoints).into();
    write("detector/detector.json", detector.to_string().as_bytes());
    write("detector/detector.onnx", networks.detector);
    write("block/object.json", object.to_string().as_bytes());
    write("block/keypoints.onnx", networks.keypoints);
    let covariance: Vec<Vec<f64>> =
        (0..6).map(|row| (0..6).map(|column| if row == column { 1e-10 } else { 0.0 }).collect()).collect();
    let reference = json!({
        "object": "block", "keypoint_model_sha256": sha256(networks.keypoints), "method": "single",
        "covariance": covariance, "references": [],
        "object_from_keypoints": {"rotation_xyzw": [0, 0, 0, 1], "translation_m": [0, 0, 0]},
    });
    write("block.json", reference.to_string().as_bytes());
}

impl Models {
    pub fn new(manifests: &Manifests, script: Script) -> Self {
        Self::load(manifests, script).unwrap()
    }

    pub fn load(manifests: &Manifests, script: Script) -> Result<Self, LoadError> {
        let folder = tempfile::tempdir().unwrap();
        write_models(folder.path(), manifests, &SCRIPTED);
        let library = Arc::new(Library::load(folder.path())?);
        let references = Arc::new(References::load(folder.path(), &library)?);
        Ok(Self { library, references, script })
    }

    /// As servers that want another probability of what is `ok`.
    pub fn demanding(mut self, ok_probability: f64) -> Self {
        let library = Arc::into_inner(self.library).unwrap().with_ok_probability(Some(ok_probability));
        self.library = Arc::new(library);
        self
    }

    pub fn estimator(&self) -> Result<Estimator, RuntimeError> {
        Estimator::new(Arc::clone(&self.library), Arc::clone(&self.references), &self.script)
    }
}

fn sha256(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}

pub fn camera() -> Camera {
    Camera::pinhole(400.0, 400.0, 160.0, 128.0).unwrap()
}

/// The pose that the scripted keypoints show.
pub fn truth() -> Pose {
    Pose::from_quaternion_xyzw([0.3, 0.4, 0.1, 0.86], [-0.02, -0.017, 0.5]).unwrap()
}

pub fn corners() -> [Vector3<f64>; 8] {
    std::array::from_fn(|k| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { SIDE_M / 2.0 } else { -SIDE_M / 2.0 }))
}

/// An image of one brightness, as a PNG file: scripts tell images apart by it.
pub fn png(brightness: u8) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image(brightness).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

pub fn image(brightness: u8) -> RgbImage {
    RgbImage::from_pixel(WIDTH, HEIGHT, colour(brightness))
}

/// Of an image that is told by its brightness: not grey, which no network is asked to judge.
pub fn colour(brightness: u8) -> image::Rgb<u8> {
    image::Rgb([brightness, 255 - brightness, 128])
}

/// The brightness of the first image of an input of bytes.
pub fn brightness(input: Input<'_>) -> u8 {
    match input {
        Input::Bytes { values, .. } => values[values.len() / 2],
        Input::Floats { .. } | Input::Halves { .. } => panic!("bytes were expected"),
    }
}

pub fn batch_of(input: Input<'_>) -> usize {
    match input {
        Input::Bytes { shape, .. } | Input::Floats { shape, .. } | Input::Halves { shape, .. } => shape[0],
    }
}

pub fn output(name: &str, shape: &[usize], values: Vec<f32>) -> Output {
    assert_eq!(shape.iter().product::<usize>(), values.len());
    Output { name: name.into(), shape: shape.into(), values }
}

#[allow(clippy::cast_possible_truncation, reason = "to a network's floats")]
pub fn end2end() -> Output {
    let [x, y, width, height] = BOX.map(|v| v as f32);
    output("detections", &[1, 1, 6], vec![x, y, x + width, y + height, 0.9, 0.0])
}

/// Where the corners are in the image.
pub fn corner_pixels() -> [Vector2<f64>; 8] {
    corners().map(|corner| camera().project(&truth().transform(&corner)).unwrap())
}

/// Where the corners are in the crop of [`BOX`], pixels.
pub fn keypoints_in_crop() -> [[f64; 2]; 8] {
    corner_pixels().map(in_crop)
}

/// Where a pixel of the image is in the crop of [`BOX`].
pub fn in_crop(pixel: Vector2<f64>) -> [f64; 2] {
    let side = SCALE * BOX[2].max(BOX[3]);
    let first_edge = [0, 1].map(|axis| BOX[axis] + BOX[axis + 2] / 2.0 - side / 2.0);
    [0, 1].map(|axis| (pixel[axis] + 0.5 - first_edge[axis]) * f64::from(CROP) / side - 0.5)
}

/// What a keypoint net says of `batch` crops of [`BOX`].
#[allow(clippy::cast_possible_truncation, reason = "to a network's floats")]
pub fn keypoints(batch: usize) -> Vec<Output> {
    let pixels = keypoints_in_crop().as_flattened().iter().map(|v| *v as f32).collect::<Vec<_>>();
    sure_of(batch, pixels.repeat(batch))
}

/// The outputs of a keypoint net that is sure of these pixels: u and v of 8 keypoints for each of `batch` crops.
pub fn sure_of(batch: usize, pixels: Vec<f32>) -> Vec<Output> {
    vec![
        output("keypoints", &[batch, 8, 2], pixels),
        output("covariances", &[batch, 8, 2, 2], [0.1, 0.0, 0.0, 0.1].repeat(8 * batch)),
        output("peaks", &[batch, 8], vec![0.9; 8 * batch]),
    ]
}
