use std::path::{Path, PathBuf};

use ort::environment::Environment;
use ort::ep;
use ort::session::Session;
use ort::value::{DynValue, TensorRef};

use super::network::{Backend, Input, Network, Output, Outputs, RuntimeError};
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
    fn load(&self, name: &str, bytes: &[u8]) -> Result<Box<dyn Network>, RuntimeError> {
        let session = self.session(bytes).map_err(|error| RuntimeError::Load {
            name: name.into(),
            provider: self.provider,
            reason: error.to_string(),
        })?;
        Ok(Box::new(OnnxNetwork { name: name.into(), session }))
    }

    fn provider(&self) -> Provider {
        self.provider
    }
}

struct OnnxNetwork {
    name: String,
    session: Session,
}

impl Network for OnnxNetwork {
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError> {
        let failed = |error: ort::Error| RuntimeError::Run { name: self.name.clone(), reason: error.to_string() };
        let input: ort::session::SessionInputValue<'_> = match input {
            Input::Bytes { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
            Input::Floats { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
        };
        let results = self.session.run(ort::inputs![input]).map_err(failed)?;
        let mut tensors = Vec::with_capacity(results.len());
        for (name, value) in &results {
            let problem =
                |problem: String| RuntimeError::Output { name: self.name.clone(), output: name.to_owned(), problem };
            let (shape, values) = floats(&value).map_err(problem)?;
            tensors.push(Output { name: name.to_owned(), shape, values });
        }
        Ok(Outputs { network: self.name.clone(), tensors })
    }
}

/// Class indices come as 64-bit integers from some exporters.
#[expect(clippy::cast_precision_loss, reason = "class indices")]
fn floats(value: &DynValue) -> Result<(Vec<usize>, Vec<f32>), String> {
    let sides = |shape: &ort::value::Shape| shape.iter().map(|side| usize::try_from(*side).unwrap_or(0)).collect();
    if let Ok((shape, values)) = value.try_extract_tensor::<f32>() {
        if !values.iter().all(|v| v.is_finite()) {
            return Err("has a value that is not finite".into());
        }
        return Ok((sides(shape), values.to_vec()));
    }
    match value.try_extract_tensor::<i64>() {
        Ok((shape, values)) => Ok((sides(shape), values.iter().map(|v| *v as f32).collect())),
        Err(_) => Err("is neither a tensor of 32-bit floats nor of 64-bit integers".into()),
    }
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
