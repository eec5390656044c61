//! What the server knows: objects, cameras and rigs.

use std::sync::Arc;

use posed_core::geometry::Camera;

use super::failure::Failure;
use super::state::Service;
use crate::model::{Catalogue, DetectorModel, InForce, ObjectModel, Rig};

/// A known object, and its reference if it is calibrated.
pub(crate) struct KnownObject {
    pub model: Arc<ObjectModel>,
    pub reference: Option<Arc<InForce>>,
    /// Why it has none, where there is a file of one.
    pub reference_problem: Option<String>,
    /// Who looks for it.
    pub detector: Option<Arc<DetectorModel>>,
}

impl Service {
    /// Every known object, calibrated or not.
    pub(crate) fn objects(&self) -> Vec<KnownObject> {
        let catalogue = self.catalogue();
        catalogue.library.known().map(|model| KnownObject::new(&catalogue, model)).collect()
    }

    pub(crate) fn object(&self, name: &str) -> Result<KnownObject, Failure> {
        let catalogue = self.catalogue();
        let model = catalogue.library.object(name).ok_or_else(|| Failure::unknown_object(name, &catalogue.library))?;
        Ok(KnownObject::new(&catalogue, model))
    }

    /// Every registered camera with its id.
    pub(crate) fn cameras(&self) -> impl Iterator<Item = (&str, &Camera)> {
        self.cameras.iter()
    }

    /// Every registered rig with its id.
    pub(crate) fn rigs(&self) -> impl Iterator<Item = (&str, &Rig)> {
        self.cameras.rigs()
    }

    pub(super) fn model(&self, name: &str) -> Result<Arc<ObjectModel>, Failure> {
        self.object(name).map(|object| object.model)
    }

    /// What to know of the objects beside that they are served: a line each.
    pub(crate) fn notes(&self) -> Vec<String> {
        let Catalogue { library, references } = &*self.catalogue();
        let unlabelled = library.without_detector().map(|name| format!("{name}: not in the detector's labels"));
        let names = library.known().map(|object| object.manifest.name.as_str());
        let uncalibrated = names.filter(|name| references.get(name).is_none()).map(|name| {
            let problem = references.problem(name);
            format!("{name}: {}", problem.unwrap_or_else(|| "not calibrated".into()))
        });
        unlabelled.chain(uncalibrated).collect()
    }
}

impl KnownObject {
    pub(super) fn new(catalogue: &Catalogue, model: &Arc<ObjectModel>) -> Self {
        let Catalogue { library, references } = catalogue;
        let name = &model.manifest.name;
        let place = library.place_of(name);
        Self {
            model: Arc::clone(model),
            reference: references.get(name),
            reference_problem: references.problem(name),
            detector: place.and_then(|place| library.detector_of(place)).map(Arc::clone),
        }
    }
}
