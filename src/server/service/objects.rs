//! What the server knows: objects, cameras and rigs.

use std::sync::Arc;

use posed_core::geometry::Camera;

use super::failure::{Failure, FailureKind};
use super::state::Service;
use crate::model::{InForce, ObjectModel, Rig};

/// A known object, and its reference if it is calibrated.
pub(crate) struct KnownObject<'a> {
    pub model: &'a ObjectModel,
    pub reference: Option<Arc<InForce>>,
    /// Why it has none, where there is a file of one.
    pub reference_problem: Option<String>,
}

impl Service {
    /// Every known object, calibrated or not.
    pub(crate) fn objects(&self) -> impl Iterator<Item = KnownObject<'_>> {
        self.library.known().map(|model| self.with_reference(model))
    }

    pub(crate) fn object(&self, name: &str) -> Result<KnownObject<'_>, Failure> {
        self.model(name).map(|model| self.with_reference(model))
    }

    /// Every registered camera with its id.
    pub(crate) fn cameras(&self) -> impl Iterator<Item = (&str, &Camera)> {
        self.cameras.iter()
    }

    /// Every registered rig with its id.
    pub(crate) fn rigs(&self) -> impl Iterator<Item = (&str, &Rig)> {
        self.cameras.rigs()
    }

    pub(super) fn model(&self, name: &str) -> Result<&ObjectModel, Failure> {
        self.library.object(name).ok_or_else(|| {
            let known: Vec<&str> = self.library.known().map(|object| object.manifest.name.as_str()).collect();
            let message = format!("unknown object {name:?}; known objects: {}", known.join(", "));
            Failure::new(FailureKind::UnknownObject, message)
        })
    }

    fn with_reference<'a>(&self, model: &'a ObjectModel) -> KnownObject<'a> {
        let name = &model.manifest.name;
        KnownObject { model, reference: self.references.get(name), reference_problem: self.references.problem(name) }
    }
}
