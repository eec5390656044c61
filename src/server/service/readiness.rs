//! Whether requests should come here, from the first moment to the last.

use std::sync::{Arc, OnceLock};

use super::state::Service;

/// Known before anything is loaded, so that probes are answered from the first moment. Clones are one.
#[derive(Clone, Default)]
pub(crate) struct Readiness {
    service: Arc<OnceLock<Arc<Service>>>,
}

impl Readiness {
    /// Everything is loaded and warmed up.
    pub(crate) fn set_ready(&self, service: Arc<Service>) {
        // Said once, by the only one who loads.
        let _ = self.service.set(service);
    }

    /// `Err` says why no request should come here now.
    pub(crate) fn check(&self) -> Result<(), &'static str> {
        self.service.get().map_or(Err("loading the models"), |service| service.serves())
    }

    /// Once it is loaded.
    pub(crate) fn service(&self) -> Option<&Service> {
        self.service.get().map(AsRef::as_ref)
    }
}
