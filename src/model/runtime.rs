use std::path::{Path, PathBuf};

use ort::environment::Environment;
use ort::session::Session;

use super::network::{Backend, LoadOptions, Network, RuntimeError};
use super::onnx::OnnxFile;
use super::provider::{Provider, ProviderSetting};
use super::session::{Batch, OnnxNetwork};

/// The loaded ONNX Runtime.
pub struct Runtime {
    environment: Environment,
    library: PathBuf,
    provider: Provider,
    /// Whether the CPU provider runs what this one cannot.
    falls_back: bool,
    threads: usize,
}

/// The cores that this process may use: a container's quota counts.
#[must_use]
pub fn available_cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

const LIBRARY: &str = "libonnxruntime.so";

/// A network of one `Relu`: what cannot run that runs nothing.
const PROBE: &[u8] = include_bytes!("probe.onnx");

impl Runtime {
    /// Loads ONNX Runtime from `ORT_DYLIB_PATH`, else beside the executable, else from `.onnxruntime/` of the working
    /// directory. Each network runs on `threads` threads of its own.
    ///
    /// # Errors
    /// When no library is found there, or it is not ONNX Runtime, or the stated provider cannot run on this machine.
    pub fn load(provider: ProviderSetting, threads: usize) -> Result<Self, RuntimeError> {
        let path = find_library()?;
        let falls_back = provider == ProviderSetting::Auto;
        let provider = provider.resolve(&path).map_err(RuntimeError::Provider)?;
        let unusable = |reason: String| RuntimeError::Library { path: path.clone(), reason };
        let environment = ort::init_from(&path)
            .map_err(|error| unusable(error.to_string()))?
            .with_telemetry(false)
            .build()
            .map_err(|error| unusable(error.to_string()))?;
        Ok(Self { environment, library: path, provider, falls_back, threads }.or_cpu())
    }

    /// The same with other threads for each network.
    #[must_use]
    pub fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// The same library with another provider or other threads: a process loads it once.
    ///
    /// # Errors
    /// When the stated provider cannot run on this machine.
    pub fn with(&self, provider: ProviderSetting, threads: usize) -> Result<Self, RuntimeError> {
        let falls_back = provider == ProviderSetting::Auto;
        let provider = provider.resolve(&self.library).map_err(RuntimeError::Provider)?;
        let (environment, library) = (self.environment.clone(), self.library.clone());
        Ok(Self { environment, library, provider, falls_back, threads }.or_cpu())
    }

    /// The CPU provider where a chosen one is installed and runs nothing, since a part of it is missing, say. A stated one
    /// stays, and fails with the first network.
    fn or_cpu(self) -> Self {
        if !self.falls_back || self.provider == Provider::Cpu {
            return self;
        }
        match self.session(self.provider, PROBE, None) {
            Ok(_) => self,
            Err(error) => {
                tracing::warn!(
                    "{} is installed, but cannot run; all networks run on the CPU provider: {error}",
                    self.provider
                );
                Self { provider: Provider::Cpu, ..self }
            }
        }
    }

    fn session(&self, provider: Provider, bytes: &[u8], fixed: Option<(&str, usize)>) -> ort::Result<Session> {
        let mut builder = Session::builder(&self.environment)?
            .with_execution_providers(provider.execution_providers(self.threads))?
            .with_intra_threads(self.threads)?
            // A spinning pool burns a core between requests.
            .with_intra_op_spinning(false)?;
        if let Some((axis, size)) = fixed {
            builder = builder.with_dimension_override(axis, i64::try_from(size).unwrap_or(i64::MAX))?;
        }
        builder.commit_from_memory(bytes)
    }

    fn sessions(
        &self,
        provider: Provider,
        file: &OnnxFile,
        bytes: &[u8],
        batches: &[usize],
    ) -> ort::Result<Vec<(Batch, Session)>> {
        match file.batch_axis().filter(|_| provider.prefers_fixed_batches() && !batches.is_empty()) {
            None => Ok(vec![(Batch::Any, self.session(provider, bytes, None)?)]),
            Some(axis) => {
                let fixed = |&size| Ok((Batch::Of(size), self.session(provider, bytes, Some((axis, size)))?));
                batches.iter().map(fixed).collect()
            }
        }
    }
}

impl Backend for Runtime {
    fn load(&self, name: &str, bytes: &[u8], options: LoadOptions<'_>) -> Result<Box<dyn Network>, RuntimeError> {
        let failed = |reason| RuntimeError::Load { name: name.into(), provider: self.provider, reason };
        let file = OnnxFile::read(bytes).map_err(failed)?;
        let on = |provider| self.sessions(provider, &file, bytes, options.batches);
        let sessions = match on(self.provider) {
            // OpenVINO cannot read some networks that are as they should be: one with a constant for an output, say.
            Err(error) if self.falls_back && self.provider != Provider::Cpu => {
                tracing::warn!("{name}: it runs on the CPU provider, since {} cannot run it: {error}", self.provider);
                on(Provider::Cpu)
            }
            sessions => sessions,
        };
        let sessions = sessions.map_err(|error| failed(error.to_string()))?;
        Ok(Box::new(OnnxNetwork::new(name, sessions, options.size).map_err(failed)?))
    }

    fn provider(&self) -> Provider {
        self.provider
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
