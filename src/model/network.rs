//! What the rest of the program knows of a network: bytes in, named tensors out.

use std::path::PathBuf;

use thiserror::Error;

use super::provider::Provider;

/// ONNX Runtime cannot be loaded, or a network cannot be loaded or run.
#[derive(Clone, Debug, Error)]
pub enum RuntimeError {
    #[error(
        "no ONNX Runtime library found; run `make onnxruntime`, or set ORT_DYLIB_PATH to libonnxruntime.so \
         (searched: {})", looked_at.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
    )]
    LibraryMissing { looked_at: Vec<PathBuf> },
    #[error("{} is not a usable ONNX Runtime library (1.24 or newer): {reason}", path.display())]
    Library { path: PathBuf, reason: String },
    #[error("{name}: ONNX Runtime cannot load this network with provider '{provider}': {reason}")]
    Load { name: String, provider: Provider, reason: String },
    #[error("{name}: the network failed: {reason}")]
    Run { name: String, reason: String },
    #[error("{name}: output '{output}' {problem}")]
    Output { name: String, output: String, problem: String },
}

/// A batch of images.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// `[batch, height, width, 3]`.
    Bytes { shape: [usize; 4], values: &'a [u8] },
    /// `[batch, 3, height, width]`.
    Floats { shape: [usize; 4], values: &'a [f32] },
}

/// A tensor that a network returned. All values are finite.
#[derive(Clone, Debug)]
pub struct Output {
    pub name: String,
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

/// Everything that a network returned, in the network's order.
#[derive(Clone, Debug)]
pub struct Outputs {
    pub network: String,
    pub tensors: Vec<Output>,
}

impl Outputs {
    /// The output of a name.
    ///
    /// # Errors
    /// When there is none.
    pub fn named(&self, name: &str) -> Result<&Output, RuntimeError> {
        self.tensors.iter().find(|output| output.name == name).ok_or_else(|| self.error(name, "is missing".into()))
    }

    /// The only output, whatever its name.
    ///
    /// # Errors
    /// When there is none.
    pub fn first(&self) -> Result<&Output, RuntimeError> {
        self.tensors.first().ok_or_else(|| self.error("0", "is missing".into()))
    }

    /// An error about an output.
    #[must_use]
    pub fn error(&self, output: &str, problem: String) -> RuntimeError {
        RuntimeError::Output { name: self.network.clone(), output: output.into(), problem }
    }
}

/// A loaded network. It keeps no state from one run to the next.
pub trait Network: Send {
    /// # Errors
    /// When the network fails or returns a value that is not finite.
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError>;
}

/// What turns the bytes of a model file into a network.
pub trait Backend: Send + Sync {
    /// Loads a network. `name` appears in error messages.
    ///
    /// # Errors
    /// When the bytes are not a network that can be run.
    fn load(&self, name: &str, bytes: &[u8]) -> Result<Box<dyn Network>, RuntimeError>;

    /// What the networks run on.
    fn provider(&self) -> Provider;
}
