//! A change of what is served, made ready beside the requests and put into force at once.

use std::sync::Arc;

use thiserror::Error;

use super::state::Service;
use crate::estimator::{CandidateError, Estimator, Update, UpdateError};
use crate::model::{Catalogue, Library, LoadError, ReferenceError, StoreError};

/// A change that was not made.
#[derive(Debug, Error)]
pub(super) enum ChangeError {
    #[error(transparent)]
    Candidate(#[from] CandidateError),
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    #[error(transparent)]
    Networks(#[from] UpdateError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("nobody waits for the change any more")]
    Abandoned,
}

impl Service {
    /// Loads and runs the networks that another library brings, and lets them go: those that never end show before anybody
    /// waits for `changing`.
    pub(super) fn rehearse(&self, library: &Arc<Library>) -> Result<(), ChangeError> {
        let old = self.catalogue();
        let references = Arc::new(old.references.renewed(&old.library, library)?);
        let catalogue = Arc::new(Catalogue { library: Arc::clone(library), references });
        Ok(Update::prepare(Some(&old.library), &catalogue, &*self.runtime).map(drop)?)
    }

    /// Whether a library follows the one that is served: none has come between.
    pub(super) fn is_next(&self, library: &Library) -> bool {
        library.generation() == self.catalogue().library.generation() + 1
    }

    /// Goes on with another library. Its new networks are loaded and run, once for each worker, while requests go on; then
    /// `commit` is the last thing that can fail. For whoever holds `changing`.
    pub(super) fn change(
        &self,
        library: Arc<Library>,
        commit: impl FnOnce() -> Result<(), ChangeError>,
    ) -> Result<Arc<Catalogue>, ChangeError> {
        let old = self.catalogue();
        let references = Arc::new(old.references.renewed(&old.library, &library)?);
        let catalogue = Arc::new(Catalogue { library, references });
        let update = |_| Update::prepare(Some(&old.library), &catalogue, &*self.runtime);
        let updates = (0..self.queue.workers()).map(update).collect::<Result<Vec<_>, _>>()?;
        commit()?;
        // Workers first: whoever sees the new catalogue is answered with it.
        self.queue.adopt(updates);
        self.current.set(Arc::clone(&catalogue));
        self.metrics.models(&catalogue.library, self.provider);
        let workers = self.queue.workers() as u64;
        self.memory.settle(Estimator::working_bytes(&catalogue.library, self.limits.max_batch) * workers);
        Ok(catalogue)
    }
}
