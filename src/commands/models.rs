use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;

use crate::estimator::Estimator;
use crate::model::{
    Catalogue, Library, LoadError, ProviderSetting, References, Runtime, RuntimeError, Trust, available_cores,
};

/// Where the models are and how they run.
#[derive(Args, Clone, Debug)]
pub(super) struct ModelArgs {
    /// Folder with one folder for each object, and `detector/` if objects share one.
    #[arg(long, env = "POSED_MODELS", default_value = "models")]
    pub(super) models: PathBuf,
    /// Folder with the reference `<object>.json` of each calibrated object.
    #[arg(long, env = "POSED_REFERENCE", default_value = "reference")]
    pub(super) reference: PathBuf,
    /// Probability from which on a pose is `ok`, 0..1, of objects whose models state probabilities [default: what they state].
    #[arg(long, env = "POSED_OK_PROBABILITY", value_parser = Trust::parse_probability)]
    ok_probability: Option<f64>,
    /// Execution provider of the networks.
    #[arg(long, env = "POSED_PROVIDER", value_enum, default_value_t)]
    provider: ProviderSetting,
    /// Threads for each network [default: the available cores, shared by parallel jobs].
    #[arg(long, env = "POSED_THREADS", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

impl ModelArgs {
    pub(super) fn runtime(&self) -> Result<Runtime, RuntimeError> {
        self.runtime_for(1)
    }

    /// A runtime whose networks run on so many threads of this program at once: they share the cores.
    pub(super) fn runtime_for(&self, jobs: usize) -> Result<Runtime, RuntimeError> {
        let share = || (available_cores() / jobs).max(1);
        Runtime::load(self.provider, self.threads.map_or_else(share, usize::from))
    }

    /// All models, and the references that are there for them.
    pub(super) fn library(&self) -> Result<(Arc<Library>, Arc<References>), LoadError> {
        let library = Arc::new(Library::load(&self.models)?.with_ok_probability(self.ok_probability));
        let references = Arc::new(References::load(&self.reference, &library)?);
        if !self.reference.is_dir() {
            tracing::warn!(
                "{}: no such folder, so that no object is calibrated; set --reference",
                self.reference.display()
            );
        }
        Ok((library, references))
    }

    /// The whole pipeline, with its models.
    pub(super) fn estimator(&self, runtime: &Runtime) -> Result<(Estimator, Arc<Catalogue>), LoadError> {
        let (library, references) = self.library()?;
        let catalogue = Arc::new(Catalogue { library, references });
        Ok((Estimator::of(Arc::clone(&catalogue), runtime)?, catalogue))
    }
}
