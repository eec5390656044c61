//! What the rest of the program knows of a network: bytes in, named tensors out.

use std::ops::Range;
use std::path::PathBuf;

use half::f16;
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
    #[error("{0}")]
    Provider(String),
    #[error("{name}: ONNX Runtime cannot load this network with provider '{provider}': {reason}")]
    Load { name: String, provider: Provider, reason: String },
    #[error("{name}: the network failed: {reason}")]
    Run { name: String, reason: String },
    #[error("{name}: output '{output}' {problem}")]
    Output { name: String, output: String, problem: String },
}

/// A batch of images: `[batch, height, width, 3]` or `[batch, 3, height, width]`.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    Bytes { shape: [usize; 4], values: &'a [u8] },
    Floats { shape: [usize; 4], values: &'a [f32] },
    Halves { shape: [usize; 4], values: &'a [f16] },
}

impl<'a> Input<'a> {
    /// The size of the batch.
    #[must_use]
    pub fn images(&self) -> usize {
        match self {
            Self::Bytes { shape, .. } | Self::Floats { shape, .. } | Self::Halves { shape, .. } => shape[0],
        }
    }

    /// Some images of the batch.
    #[must_use]
    pub fn slice(&self, images: Range<usize>) -> Input<'a> {
        fn part<T>(shape: [usize; 4], values: &[T], images: Range<usize>) -> ([usize; 4], &[T]) {
            let [_, rows @ ..] = shape;
            let each: usize = rows.iter().product();
            ([images.len(), rows[0], rows[1], rows[2]], &values[images.start * each..images.end * each])
        }
        match *self {
            Self::Bytes { shape, values } => {
                let (shape, values) = part(shape, values, images);
                Input::Bytes { shape, values }
            }
            Self::Floats { shape, values } => {
                let (shape, values) = part(shape, values, images);
                Input::Floats { shape, values }
            }
            Self::Halves { shape, values } => {
                let (shape, values) = part(shape, values, images);
                Input::Halves { shape, values }
            }
        }
    }
}

/// How a network will be fed.
#[derive(Clone, Copy, Debug, Default)]
pub struct LoadOptions<'a> {
    /// Its input beside the image, if it has one.
    pub size: Option<SizeInput<'a>>,
    /// Sizes of the batches that it is given most often, 1 among them: some providers make a program for each. Other sizes
    /// are made up of these. Empty where the network itself states the size.
    pub batches: &'a [usize],
}

/// An input beside the image that is given the image's size: 64-bit integers `[1, 2]`.
#[derive(Clone, Copy, Debug)]
pub struct SizeInput<'a> {
    pub name: &'a str,
    pub width: u32,
    pub height: u32,
}

/// A tensor of numbers that a network returned. They need not be finite: one bad value is the matter of who uses it.
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
    /// Names of outputs that are no tensors of numbers. Nobody minds them unless they are needed.
    pub others: Vec<String>,
}

impl Outputs {
    /// Whether there is an output of this name, of whatever kind.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.tensors.iter().any(|output| output.name == name) || self.others.iter().any(|other| other == name)
    }

    /// The output of a name.
    ///
    /// # Errors
    /// When there is none.
    pub fn named(&self, name: &str) -> Result<&Output, RuntimeError> {
        let found = self.tensors.iter().find(|output| output.name == name);
        found.ok_or_else(|| {
            let other = self.others.iter().any(|other| other == name);
            self.error(name, if other { "is no tensor of numbers" } else { "is missing" }.into())
        })
    }

    /// Adds what the network says of further images.
    ///
    /// # Errors
    /// When an output is not one for each image.
    pub fn append(&mut self, more: Self) -> Result<(), RuntimeError> {
        for tensor in more.tensors {
            let name = self.network.clone();
            let problem = || RuntimeError::Output {
                name,
                output: tensor.name.clone(),
                problem: format!("has shape {:?} for one batch and another one for the next", tensor.shape),
            };
            let fits = |one: &&mut Output| one.name == tensor.name && one.shape.get(1..) == tensor.shape.get(1..);
            match (self.tensors.iter_mut().find(fits), tensor.shape.first()) {
                (Some(one), Some(images)) => {
                    one.shape[0] += images;
                    one.values.extend(tensor.values);
                }
                _ => return Err(problem()),
            }
        }
        Ok(())
    }

    /// The first output, whatever its name: the only one of most networks.
    ///
    /// # Errors
    /// When there is none.
    pub fn first(&self) -> Result<&Output, RuntimeError> {
        self.tensors.first().ok_or_else(|| self.error("0", "is missing, or no tensor of numbers".into()))
    }

    /// An error about what the network says.
    #[must_use]
    pub fn failed(&self, reason: String) -> RuntimeError {
        RuntimeError::Run { name: self.network.clone(), reason }
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
    /// When the network fails.
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError>;
}

/// A keypoint net, and whether it takes its crops one at a time. Some exporters fix the batch axis at 1; that shows when
/// several crops fail together and not alone.
pub struct KeypointNet {
    pub network: Box<dyn Network>,
    pub one_by_one: bool,
}

impl KeypointNet {
    #[must_use]
    pub fn new(network: Box<dyn Network>) -> Self {
        Self { network, one_by_one: false }
    }
}

/// What turns the bytes of a model file into a network.
pub trait Backend: Send + Sync {
    /// Loads a network. `name` appears in error messages.
    ///
    /// # Errors
    /// When the bytes are not a network that can be run.
    fn load(&self, name: &str, bytes: &[u8], options: LoadOptions<'_>) -> Result<Box<dyn Network>, RuntimeError>;

    /// What the networks run on.
    fn provider(&self) -> Provider;
}
