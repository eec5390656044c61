use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use super::library::{Library, ObjectModel};
use super::reference::{Reference, ReferenceError, write_atomically};

/// The references in force. Replacing one takes effect with the next image.
pub struct References {
    folder: PathBuf,
    by_object: RwLock<BTreeMap<String, Entry>>,
}

enum Entry {
    InForce(Arc<Reference>),
    /// Why it is not in force.
    Unusable(String),
}

impl References {
    /// Reads `folder/<object>.json` of each of a library's objects that has one.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one.
    pub fn load(folder: &Path, library: &Library) -> Result<Self, ReferenceError> {
        Self::load_or(folder, library, Err)
    }

    /// As [`References::load`], but an object whose reference belongs to another network goes without one: one object
    /// that was trained anew does not stop the others. [`References::problem`] says why.
    ///
    /// # Errors
    /// As [`References::load`], for other faults.
    pub fn load_usable(folder: &Path, library: &Library) -> Result<Self, ReferenceError> {
        Self::load_or(folder, library, |error| {
            let ReferenceError::OtherModel { object, stated, found, .. } = error else { return Err(error) };
            Ok(format!(
                "its reference belongs to another keypoint net (sha256 {stated}; the current one has {found}); make a new \
                 one with `posed calibrate {object}`"
            ))
        })
    }

    fn load_or(
        folder: &Path,
        library: &Library,
        unusable: impl Fn(ReferenceError) -> Result<String, ReferenceError>,
    ) -> Result<Self, ReferenceError> {
        let mut by_object = BTreeMap::new();
        for object in library.known() {
            let entry = match Self::read(folder, object) {
                Ok(None) => continue,
                Ok(Some(reference)) => Entry::InForce(Arc::new(reference)),
                Err(error) => Entry::Unusable(unusable(error)?),
            };
            by_object.insert(object.manifest.name.clone(), entry);
        }
        Ok(Self { folder: folder.into(), by_object: RwLock::new(by_object) })
    }

    /// Reads one object's reference, if it has one.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one.
    pub fn read(folder: &Path, object: &ObjectModel) -> Result<Option<Reference>, ReferenceError> {
        let path = folder.join(format!("{}.json", object.manifest.name));
        let read = || Reference::read(&path, &object.manifest.name, &object.manifest.model_sha256);
        path.exists().then(read).transpose()
    }

    /// The reference of an object, if it is calibrated.
    #[must_use]
    pub fn get(&self, object: &str) -> Option<Arc<Reference>> {
        // A map of whole references is valid whoever panicked beside it.
        match self.by_object.read().unwrap_or_else(PoisonError::into_inner).get(object)? {
            Entry::InForce(reference) => Some(Arc::clone(reference)),
            Entry::Unusable(_) => None,
        }
    }

    /// Why the reference of an object is not in force.
    #[must_use]
    pub fn problem(&self, object: &str) -> Option<String> {
        match self.by_object.read().unwrap_or_else(PoisonError::into_inner).get(object)? {
            Entry::InForce(_) => None,
            Entry::Unusable(problem) => Some(problem.clone()),
        }
    }

    /// Writes a reference with its images, then puts it into force. Readers of the folder see the old reference or the
    /// new one, never a part.
    ///
    /// # Errors
    /// When the folder cannot be written to; the old reference stays in force.
    pub fn replace(&self, reference: Reference, images: &[(String, Vec<u8>)]) -> Result<(), ReferenceError> {
        Self::write(&self.folder, &reference, images)?;
        self.put(reference);
        Ok(())
    }

    /// Writes a reference with its images.
    ///
    /// # Errors
    /// When the folder cannot be written to.
    pub fn write(folder: &Path, reference: &Reference, images: &[(String, Vec<u8>)]) -> Result<(), ReferenceError> {
        // The images first: a reference must never name an image that is not there.
        for (name, bytes) in images {
            let path = folder.join(name);
            write_atomically(&path, bytes).map_err(|source| ReferenceError::Write { path, source })?;
        }
        reference.write(&folder.join(format!("{}.json", reference.object)))
    }

    /// Where the references lie.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn put(&self, reference: Reference) {
        let mut by_object = self.by_object.write().unwrap_or_else(PoisonError::into_inner);
        by_object.insert(reference.object.clone(), Entry::InForce(Arc::new(reference)));
    }
}
