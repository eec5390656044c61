use std::path::{Path, PathBuf};

use clap::ValueEnum;
use ort::ep::{self, ArbitrarilyConfigurableExecutionProvider, ExecutionProviderDispatch};
use serde::Serialize;

/// What runs the networks: an execution provider of ONNX Runtime.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Provider {
    Cpu,
    Openvino,
    Cuda,
    Tensorrt,
}

/// What the user wants to run the networks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ProviderSetting {
    /// OpenVINO where it is installed and the processor is one that it is faster on, else the CPU provider, which also runs
    /// single networks that OpenVINO cannot.
    #[default]
    Auto,
    Cpu,
    Openvino,
    Cuda,
    Tensorrt,
}

/// The file that ONNX Runtime loads OpenVINO from, beside its own library.
const OPENVINO_LIBRARY: &str = "libonnxruntime_providers_openvino.so";

/// 32-bit floats where a network has them: on processors with bf16 units OpenVINO would round them, and keypoints hang on
/// small differences. Threads stay where the system puts them, since others run here, too.
const OPENVINO_SETTINGS: &str = r#"{"CPU": {"INFERENCE_PRECISION_HINT": "f32", "ENABLE_CPU_PINNING": "NO"}}"#;

impl ProviderSetting {
    /// The provider for this machine. `library` is ONNX Runtime's.
    ///
    /// # Errors
    /// When OpenVINO is stated and cannot run here. Whether a GPU can be used shows when a network is loaded.
    pub fn resolve(self, library: &Path) -> Result<Provider, String> {
        match self {
            Self::Cpu => Ok(Provider::Cpu),
            Self::Cuda => Ok(Provider::Cuda),
            Self::Tensorrt => Ok(Provider::Tensorrt),
            Self::Auto => Ok(if openvino_problem(library).is_none() { Provider::Openvino } else { Provider::Cpu }),
            Self::Openvino => openvino_problem(library).map_or(Ok(Provider::Openvino), Err),
        }
    }
}

/// Why OpenVINO cannot run here, or would not be faster.
fn openvino_problem(library: &Path) -> Option<String> {
    if !has_avx2() {
        return Some("OpenVINO needs an x86-64 processor with AVX2; use --provider cpu".into());
    }
    let plugin = library.with_file_name(OPENVINO_LIBRARY);
    (!plugin.is_file())
        .then(|| format!("{} is missing; run `make onnxruntime`, or use --provider cpu", plugin.display()))
}

/// As the XDG Base Directory Specification has it.
fn cache_folder() -> PathBuf {
    let stated = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from).filter(|path| path.is_absolute());
    let at_home = || std::env::home_dir().unwrap_or_else(std::env::temp_dir).join(".cache");
    stated.unwrap_or_else(at_home).join("posed")
}

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    std::arch::is_x86_feature_detected!("avx2")
}

#[cfg(not(target_arch = "x86_64"))]
fn has_avx2() -> bool {
    false
}

impl Provider {
    /// For a session whose networks run on so many threads. A provider that cannot run is an error: ONNX Runtime would go
    /// on with the CPU and say nothing.
    pub(super) fn execution_providers(self, threads: usize) -> Vec<ExecutionProviderDispatch> {
        match self {
            Self::Cpu => Vec::new(),
            Self::Cuda => vec![ep::CUDA::default().build().error_on_failure()],
            Self::Tensorrt => {
                // What it builds of a network takes minutes, and is kept.
                let engines = cache_folder().join("tensorrt").display().to_string();
                let cached = ep::TensorRT::default().with_engine_cache(true).with_engine_cache_path(engines);
                vec![cached.with_fp16(true).build().error_on_failure()]
            }
            Self::Openvino => {
                let openvino = ep::OpenVINO::default().with_device_type("CPU").with_num_threads(threads);
                vec![openvino.with_arbitrary_config("load_config", OPENVINO_SETTINGS).build().error_on_failure()]
            }
        }
    }

    /// Whether several workers of one thread each are faster than one of several: two threads of OpenVINO wait for each
    /// other in a loop.
    #[must_use]
    pub fn prefers_workers(self) -> bool {
        self == Self::Openvino
    }

    /// Whether networks run faster with the size of their batches fixed. OpenVINO takes half as long again without
    /// (docs/benchmarks/providers.md); the others do not care.
    pub(super) fn prefers_fixed_batches(self) -> bool {
        self == Self::Openvino
    }
}

impl std::fmt::Display for Provider {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.pad(match self {
            Self::Cpu => "cpu",
            Self::Openvino => "openvino",
            Self::Cuda => "cuda",
            Self::Tensorrt => "tensorrt",
        })
    }
}
