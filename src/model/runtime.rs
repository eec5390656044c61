use std::path::{Path, PathBuf};

use ort::environment::Environment;
use ort::session::Session;
use ort::value::TensorRef;
use thiserror::Error;

/// ONNX Runtime cannot be loaded, or a network cannot be loaded or run.
#[derive(Debug, Error)]
pub enum RuntimeError {
    #[error(
        "no ONNX Runtime library found; `make onnxruntime` puts it into .onnxruntime/, or set ORT_DYLIB_PATH to \
         libonnxruntime.so (looked at: {})", looked_at.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    LibraryMissing { looked_at: Vec<PathBuf> },
    #[error("{} is not a usable ONNX Runtime library (1.24 or newer is needed): {reason}", path.display())]
    Library { path: PathBuf, reason: String },
    #[error("{name}: ONNX Runtime cannot load this network: {reason}")]
    Load { name: String, reason: String },
    #[error("{name}: the network failed: {reason}")]
    Run { name: String, reason: String },
    #[error("{name}: output '{output}' {problem}")]
    Output { name: String, output: &'static str, problem: String },
}

/// The loaded ONNX Runtime.
pub struct Runtime {
    environment: Environment,
    threads: usize,
}

/// A float tensor that a network returned.
#[derive(Clone, Debug)]
pub struct Tensor {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

/// A network that takes one batch of 8-bit RGB images and returns named float tensors.
pub struct Network {
    name: String,
    session: Session,
}

const LIBRARY: &str = "libonnxruntime.so";

impl Runtime {
    /// Loads ONNX Runtime from `ORT_DYLIB_PATH`, else beside the executable, else from `.onnxruntime/` of the working
    /// directory. Networks run on `threads` threads.
    ///
    /// # Errors
    /// When no library is found there, or it is not ONNX Runtime.
    pub fn load(threads: usize) -> Result<Self, RuntimeError> {
        let path = find_library()?;
        let unusable = |reason: String| RuntimeError::Library { path: path.clone(), reason };
        let environment = ort::init_from(&path)
            .map_err(|error| unusable(error.to_string()))?
            .with_telemetry(false)
            .build()
            .map_err(|error| unusable(error.to_string()))?;
        Ok(Self { environment, threads })
    }

    /// Loads a network from its bytes. `name` appears in error messages.
    ///
    /// # Errors
    /// When the bytes are not a network that ONNX Runtime can run.
    pub fn network(&self, name: &str, bytes: &[u8]) -> Result<Network, RuntimeError> {
        let session = (|| {
            Session::builder(&self.environment)?
                .with_intra_threads(self.threads)?
                // A spinning pool burns a core between requests.
                .with_intra_op_spinning(false)?
                .commit_from_memory(bytes)
        })()
        .map_err(|error: ort::Error| RuntimeError::Load { name: name.into(), reason: error.to_string() })?;
        Ok(Network { name: name.into(), session })
    }
}

impl Network {
    /// Runs the network on `[batch, height, width, 3]` and returns the outputs asked for, in that order.
    ///
    /// # Errors
    /// When the network fails, lacks an output, or returns a value that is not a finite float.
    pub fn run<const N: usize>(
        &mut self,
        rgb: &[u8],
        shape: [usize; 4],
        outputs: [&'static str; N],
    ) -> Result<[Tensor; N], RuntimeError> {
        let failed = |error: ort::Error| RuntimeError::Run { name: self.name.clone(), reason: error.to_string() };
        let input = TensorRef::from_array_view((shape, rgb)).map_err(failed)?;
        let results = self.session.run(ort::inputs![input]).map_err(failed)?;
        let mut tensors = Vec::with_capacity(N);
        for output in outputs {
            let problem = |problem: String| RuntimeError::Output { name: self.name.clone(), output, problem };
            let value = results.get(output).ok_or_else(|| problem("is missing".into()))?;
            let (dimensions, values) =
                value.try_extract_tensor::<f32>().map_err(|error| problem(format!("is no float tensor: {error}")))?;
            if !values.iter().all(|v| v.is_finite()) {
                return Err(problem("has a value that is not finite".into()));
            }
            let shape = dimensions.iter().map(|side| usize::try_from(*side).unwrap_or(0)).collect();
            tensors.push(Tensor { shape, values: values.to_vec() });
        }
        tensors.try_into().map_err(|_| RuntimeError::Run { name: self.name.clone(), reason: "output count".into() })
    }

    /// An error about an output of this network.
    #[must_use]
    pub fn output_error(&self, output: &'static str, problem: String) -> RuntimeError {
        RuntimeError::Output { name: self.name.clone(), output, problem }
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
