//! Whether requests should come here, from the first moment to the last.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use super::state::Service;

/// Known before anything is loaded, so that probes are answered from the first moment. Clones are one.
#[derive(Clone, Default)]
pub(crate) struct Readiness {
    service: Arc<OnceLock<Arc<Service>>>,
    draining: Arc<AtomicBool>,
}

impl Readiness {
    /// Everything is loaded and warmed up.
    pub(crate) fn set_ready(&self, service: Arc<Service>) {
        // Said once, by the only one who loads.
        let _ = self.service.set(service);
    }

    pub(crate) fn set_draining(&self) {
        self.draining.store(true, Ordering::Relaxed);
    }

    /// `Err` says why no request should come here now.
    pub(crate) fn check(&self) -> Result<(), &'static str> {
        let Some(service) = self.service.get() else { return Err("loading the models") };
        if self.draining.load(Ordering::Relaxed) {
            return Err("shutting down");
        }
        service.serves()
    }

    /// Once it is loaded.
    pub(crate) fn service(&self) -> Option<&Service> {
        self.service.get().map(AsRef::as_ref)
    }
}
