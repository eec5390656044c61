use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use super::file_version::FileVersion;
use super::in_force::InForce;
use super::left_over::{images_of, sweep};
use super::library::Library;
use super::manifest::sha256_hex;
use super::object::ObjectModel;
use super::reference::{Reference, ReferenceError, write_atomically};

/// The references in force: of each object the file in a folder of references, else the one that its own folder brings along.
/// Replacing one takes effect with the next image.
pub struct References {
    folder: PathBuf,
    by_object: RwLock<BTreeMap<String, Entry>>,
}

#[derive(Clone)]
struct Entry {
    state: State,
    /// The file in the folder of references as it was looked at last.
    file: Option<FileVersion>,
}

#[derive(Clone)]
enum State {
    InForce(Arc<InForce>),
    /// Why it is not in force.
    Unusable(String),
}

impl References {
    /// Reads `folder/<object>.json` of each of a library's objects that has one.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one.
    pub fn load(folder: &Path, library: &Library) -> Result<Self, ReferenceError> {
        let references = Self::empty(folder);
        for object in library.known() {
            references.take_up(object, Err)?;
        }
        Ok(references)
    }

    /// As [`References::load`], but an object whose reference belongs to another network goes without one: one object
    /// that was trained anew does not stop the others. [`References::problem`] says why.
    ///
    /// # Errors
    /// As [`References::load`], for other faults.
    pub fn load_usable(folder: &Path, library: &Library) -> Result<Self, ReferenceError> {
        let references = Self::empty(folder);
        for object in library.known() {
            references.take_up(object, usable)?;
        }
        Ok(references)
    }

    /// Those of another library: what has not changed is as it is here, the rest as [`load_usable`](Self::load_usable) reads it.
    ///
    /// # Errors
    /// As [`References::load_usable`].
    pub fn renewed(&self, old: &Library, new: &Library) -> Result<Self, ReferenceError> {
        let references = Self::empty(&self.folder);
        for object in new.known() {
            let name = &object.manifest.name;
            let goes_on = old.object(name).is_some_and(|old| Arc::ptr_eq(old, object));
            match self.entry(name).filter(|_| goes_on) {
                Some(entry) => references.put(object, entry),
                None if goes_on => {}
                None => references.take_up(object, usable)?,
            }
        }
        Ok(references)
    }

    fn empty(folder: &Path) -> Self {
        Self { folder: folder.into(), by_object: RwLock::default() }
    }

    fn take_up(
        &self,
        object: &ObjectModel,
        unusable: impl Fn(ReferenceError) -> Result<String, ReferenceError>,
    ) -> Result<(), ReferenceError> {
        let file = FileVersion::of(&self.path(object)).ok();
        let own = || match &object.reference {
            Some(Ok(in_force)) => Some(State::InForce(Arc::clone(in_force))),
            Some(Err(problem)) => Some(State::Unusable(problem.clone())),
            None => None,
        };
        let read = file.map(|_| self.read_file(object));
        let state = match read {
            Some(Ok(in_force)) => Some(State::InForce(Arc::new(in_force))),
            // One that was made for an earlier network, before this one came with its own.
            Some(Err(ReferenceError::OtherModel { .. })) if matches!(object.reference, Some(Ok(_))) => own(),
            Some(Err(error)) => Some(State::Unusable(unusable(error)?)),
            None => own(),
        };
        if let Some(state) = state {
            self.put(object, Entry { state, file });
        }
        Ok(())
    }

    /// Reads one object's reference, if it has one.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one.
    pub fn read(folder: &Path, object: &ObjectModel) -> Result<Option<Reference>, ReferenceError> {
        let references = Self::empty(folder);
        references.take_up(object, Err)?;
        Ok(references.get(&object.manifest.name).map(|in_force| in_force.reference.clone()))
    }

    /// The reference of an object, if it is calibrated.
    #[must_use]
    pub fn get(&self, object: &str) -> Option<Arc<InForce>> {
        match self.entry(object)?.state {
            State::InForce(in_force) => Some(in_force),
            State::Unusable(_) => None,
        }
    }

    /// `keypoints_scale` of the object's reference as it is in the folder now, else of that in force; 1 without any.
    #[must_use]
    pub fn stored_scale(&self, object: &ObjectModel) -> f64 {
        let of = |in_force: &InForce| in_force.reference.offset.keypoints_scale;
        let in_force = || self.get(&object.manifest.name).map(|in_force| of(&in_force));
        self.read_file(object).as_ref().ok().map(of).or_else(in_force).unwrap_or(1.0)
    }

    /// Why the reference of an object is not in force.
    #[must_use]
    pub fn problem(&self, object: &str) -> Option<String> {
        match self.entry(object)?.state {
            State::InForce(_) => None,
            State::Unusable(problem) => Some(problem),
        }
    }

    /// Whether the file of an object's reference is another one than was looked at last: another process may have replaced it.
    #[must_use]
    pub fn has_changed(&self, object: &ObjectModel) -> bool {
        let now = FileVersion::of(&self.path(object)).ok();
        now.is_some() && now != self.entry(&object.manifest.name).and_then(|entry| entry.file)
    }

    /// Puts into force what an object's file says.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one; the old reference stays in force.
    pub fn reload(&self, object: &ObjectModel) -> Result<Arc<InForce>, ReferenceError> {
        let file = FileVersion::of(&self.path(object)).ok();
        match self.read_file(object) {
            Ok(in_force) => {
                let in_force = Arc::new(in_force);
                self.put(object, Entry { state: State::InForce(Arc::clone(&in_force)), file });
                Ok(in_force)
            }
            Err(error) => {
                let mut by_object = self.by_object.write().unwrap_or_else(PoisonError::into_inner);
                if let Some(entry) = by_object.get_mut(&object.manifest.name) {
                    entry.file = file;
                } else {
                    let state = State::Unusable(error.to_string());
                    by_object.insert(object.manifest.name.clone(), Entry { state, file });
                }
                Err(error)
            }
        }
    }

    fn read_file(&self, object: &ObjectModel) -> Result<InForce, ReferenceError> {
        let manifest = &object.manifest;
        InForce::read(&self.path(object), &manifest.name, &manifest.model_sha256, self.folder.clone())
    }

    /// Writes a reference with its images, then puts it into force. Readers of the folder see the old reference or the
    /// new one, never a part.
    ///
    /// # Errors
    /// When the folder cannot be written to; the old reference stays in force.
    pub fn replace(
        &self,
        object: &ObjectModel,
        reference: &Reference,
        images: &[(String, Vec<u8>)],
    ) -> Result<Arc<InForce>, ReferenceError> {
        Self::write(&self.folder, reference, images)?;
        self.reload(object)
    }

    /// Writes a reference with its images, whose names are those of [`image_name`](Self::image_name): no file that the
    /// old reference names is touched before the new one is in place, and none is left behind.
    ///
    /// # Errors
    /// When the folder cannot be written to; what it held is as it was.
    pub fn write(folder: &Path, reference: &Reference, images: &[(String, Vec<u8>)]) -> Result<(), ReferenceError> {
        let path = file_of(folder, &reference.object);
        let old = images_of(&path);
        let mut written = Vec::new();
        let result = (|| {
            // The images first: a reference must never name an image that is not there.
            for (name, bytes) in images {
                let path = folder.join(name);
                if !path.exists() {
                    write_atomically(&path, bytes).map_err(|source| ReferenceError::Write { path, source })?;
                    written.push(name.clone());
                }
            }
            reference.write(&path)
        })();
        let kept = |name: &String| images.iter().any(|(image, _)| image == name);
        let left_over = if result.is_ok() { old.into_iter().filter(|name| !kept(name)).collect() } else { written };
        for name in left_over {
            // A file too many does no harm.
            let _ = fs::remove_file(folder.join(name));
        }
        result
    }

    /// What an image of an object's reference is called: by what is in it, so that a new one never overwrites another.
    #[must_use]
    pub fn image_name(object: &str, image: &[u8], ending: &str) -> String {
        format!("{object}-{}.{ending}", &sha256_hex(image)[..12])
    }

    /// Fails where references cannot be written. Removes what an earlier program left over that was killed while it wrote.
    ///
    /// # Errors
    /// [`ReferenceError::Write`] names the folder.
    pub fn check_writable(&self) -> Result<(), ReferenceError> {
        let written = fs::create_dir_all(&self.folder).and_then(|()| tempfile::tempfile_in(&self.folder).map(drop));
        written.map_err(|source| ReferenceError::Write { path: self.folder.clone(), source })?;
        sweep(&self.folder);
        Ok(())
    }

    fn entry(&self, object: &str) -> Option<Entry> {
        // A map of whole entries is valid whoever panicked beside it.
        self.by_object.read().unwrap_or_else(PoisonError::into_inner).get(object).cloned()
    }

    fn put(&self, object: &ObjectModel, entry: Entry) {
        let mut by_object = self.by_object.write().unwrap_or_else(PoisonError::into_inner);
        by_object.insert(object.manifest.name.clone(), entry);
    }

    fn path(&self, object: &ObjectModel) -> PathBuf {
        file_of(&self.folder, &object.manifest.name)
    }
}

impl fmt::Debug for References {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("References").field("folder", &self.folder).finish_non_exhaustive()
    }
}

/// A reference of another network disables its object.
fn usable(error: ReferenceError) -> Result<String, ReferenceError> {
    if matches!(error, ReferenceError::OtherModel { .. }) { Ok(error.of_another_net()) } else { Err(error) }
}

/// The file of an object's reference.
fn file_of(folder: &Path, object: &str) -> PathBuf {
    folder.join(format!("{object}.json"))
}
