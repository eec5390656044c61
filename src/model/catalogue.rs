use std::sync::{Arc, PoisonError, RwLock};

use super::library::Library;
use super::references::References;

/// All that is served at one moment.
#[derive(Clone, Debug)]
pub struct Catalogue {
    pub library: Arc<Library>,
    pub references: Arc<References>,
}

/// The catalogue in force. Whoever works with one keeps it to the end.
pub struct Current(RwLock<Arc<Catalogue>>);

impl Current {
    #[must_use]
    pub fn new(catalogue: Arc<Catalogue>) -> Self {
        Self(RwLock::new(catalogue))
    }

    #[must_use]
    pub fn get(&self) -> Arc<Catalogue> {
        // A whole one is replaced: valid whoever panicked beside it.
        Arc::clone(&self.0.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// From now on.
    pub fn set(&self, catalogue: Arc<Catalogue>) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = catalogue;
    }
}
