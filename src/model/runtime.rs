use std::path::{Path, PathBuf};

use half::f16;
use ort::environment::Environment;
use ort::ep;
use ort::session::Session;
use ort::value::{DynValue, Outlet, TensorRef};

use super::network::{Backend, Input, Network, Output, Outputs, RuntimeError, SizeInput};
use super::onnx::check_is_whole;
use super::provider::Provider;

/// The loaded ONNX Runtime.
pub struct Runtime {
    environment: Environment,
    provider: Provider,
    threads: usize,
}

/// The cores that this process may use: a container's quota counts.
#[must_use]
pub fn available_cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

const LIBRARY: &str = "libonnxruntime.so";

impl Runtime {
    /// Loads ONNX Runtime from `ORT_DYLIB_PATH`, else beside the executable, else from `.onnxruntime/` of the working
    /// directory. Each network runs on `threads` threads of its own.
    ///
    /// # Errors
    /// When no library is found there, or it is not ONNX Runtime.
    pub fn load(provider: Provider, threads: usize) -> Result<Self, RuntimeError> {
        let path = find_library()?;
        let unusable = |reason: String| RuntimeError::Library { path: path.clone(), reason };
        let environment = ort::init_from(&path)
            .map_err(|error| unusable(error.to_string()))?
            .with_telemetry(false)
            .build()
            .map_err(|error| unusable(error.to_string()))?;
        Ok(Self { environment, provider, threads })
    }

    fn session(&self, bytes: &[u8]) -> ort::Result<Session> {
        // Without `error_on_failure` ONNX Runtime would go on with the CPU and say nothing.
        let providers = match self.provider {
            Provider::Cpu => Vec::new(),
            Provider::Cuda => vec![ep::CUDA::default().build().error_on_failure()],
            Provider::Tensorrt => vec![ep::TensorRT::default().build().error_on_failure()],
            Provider::Openvino => vec![ep::OpenVINO::default().build().error_on_failure()],
        };
        Session::builder(&self.environment)?
            .with_execution_providers(providers)?
            .with_intra_threads(self.threads)?
            // A spinning pool burns a core between requests.
            .with_intra_op_spinning(false)?
            .commit_from_memory(bytes)
    }
}

impl Backend for Runtime {
    fn load(&self, name: &str, bytes: &[u8], size: Option<SizeInput<'_>>) -> Result<Box<dyn Network>, RuntimeError> {
        let failed = |reason| RuntimeError::Load { name: name.into(), provider: self.provider, reason };
        check_is_whole(bytes).map_err(failed)?;
        let session = self.session(bytes).map_err(|error| failed(error.to_string()))?;
        let image = image_input(&session, size).map_err(failed)?;
        let size = size.map(|size| (size.name.to_owned(), [size.width, size.height].map(i64::from)));
        Ok(Box::new(OnnxNetwork { name: name.into(), session, image, size }))
    }

    fn provider(&self) -> Provider {
        self.provider
    }
}

struct OnnxNetwork {
    name: String,
    session: Session,
    /// Name of the image's input.
    image: String,
    /// Another input, and the width and height that it is given.
    size: Option<(String, [i64; 2])>,
}

/// The name of the input that is the image: the only one beside that for the size.
fn image_input(session: &Session, size: Option<SizeInput<'_>>) -> Result<String, String> {
    let names: Vec<&str> = session.inputs().iter().map(Outlet::name).collect();
    let others: Vec<&str> = names.iter().copied().filter(|name| size.is_none_or(|size| size.name != *name)).collect();
    if let Some(SizeInput { name, .. }) = size.filter(|_| others.len() == names.len()) {
        return Err(format!("it has no input {name:?} ('input.size_input'); its inputs are {names:?}"));
    }
    match others[..] {
        [image] => Ok(image.to_owned()),
        _ => Err(format!(
            "its inputs are {names:?}, but only an image is given; if one is for the size of the image, as              \"orig_target_sizes\" of a detector, name it in 'input.size_input'"
        )),
    }
}

impl Network for OnnxNetwork {
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError> {
        let failed = |error: ort::Error| RuntimeError::Run { name: self.name.clone(), reason: error.to_string() };
        let input: ort::session::SessionInputValue<'_> = match input {
            Input::Bytes { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
            Input::Floats { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
            Input::Halves { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
        };
        let mut inputs = vec![(self.image.as_str(), input)];
        if let Some((name, size)) = &self.size {
            let size = TensorRef::from_array_view(([1, size.len()], size.as_slice())).map_err(failed)?;
            inputs.push((name, size.into()));
        }
        let results = self.session.run(inputs).map_err(failed)?;
        let (mut tensors, mut others) = (Vec::with_capacity(results.len()), Vec::new());
        for (name, value) in &results {
            match numbers(&value) {
                Some((shape, values)) => tensors.push(Output { name: name.to_owned(), shape, values }),
                None => others.push(name.to_owned()),
            }
        }
        Ok(Outputs { network: self.name.clone(), tensors, others })
    }
}

/// A tensor's shape and values. Exporters differ in the types of class indices and counts.
#[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "class indices, counts and pixels")]
fn numbers(value: &DynValue) -> Option<(Vec<usize>, Vec<f32>)> {
    fn read<T>(value: &DynValue, float: impl Fn(&T) -> f32) -> Option<(Vec<usize>, Vec<f32>)>
    where
        T: ort::value::PrimitiveTensorElementType + std::fmt::Debug,
    {
        let (shape, values) = value.try_extract_tensor::<T>().ok()?;
        let sides = shape.iter().map(|side| usize::try_from(*side).unwrap_or(0)).collect();
        Some((sides, values.iter().map(float).collect()))
    }
    read::<f32>(value, |v| *v)
        .or_else(|| read::<f16>(value, |v| v.to_f32()))
        .or_else(|| read::<i64>(value, |v| *v as f32))
        .or_else(|| read::<i32>(value, |v| *v as f32))
        .or_else(|| read::<f64>(value, |v| *v as f32))
}

fn find_library() -> Result<PathBuf, RuntimeError> {
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from) {
        // Stated by the user: never fall back to another one.
        return if path.is_file() { Ok(path) } else { Err(RuntimeError::LibraryMissing { looked_at: vec![path] }) };
    }
    let beside = std::env::current_exe().ok().and_then(|exe| exe.parent().map(|folder| folder.join(LIBRARY)));
    let looked_at: Vec<PathBuf> = beside.into_iter().chain([Path::new(".onnxruntime").join(LIBRARY)]).collect();
    match looked_at.iter().find(|path| path.is_file()) {
        // A bare relative path would be searched for in the system's folders.
        Some(path) => Ok(path.canonicalize().unwrap_or_else(|_| path.clone())),
        None => Err(RuntimeError::LibraryMissing { looked_at }),
    }
}
