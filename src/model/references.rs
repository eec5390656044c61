use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use super::library::{Library, ObjectModel};
use super::manifest::{MAX_JSON_BYTES, ManifestError, read_bytes, sha256_hex};
use super::reference::{Reference, ReferenceError, write_atomically};

/// The references in force. Replacing one takes effect with the next image.
pub struct References {
    folder: PathBuf,
    by_object: RwLock<BTreeMap<String, Entry>>,
}

enum Entry {
    InForce(Arc<InForce>),
    /// Why it is not in force.
    Unusable(String),
}

/// A reference, and which file it came from.
#[derive(Clone, Debug)]
pub struct InForce {
    pub reference: Reference,
    pub sha256: String,
    pub version: FileVersion,
}

/// What changes when a file does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileVersion {
    pub modified: SystemTime,
    bytes: u64,
    /// A file that is renamed to this name within the clock's resolution is another one.
    node: u64,
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
        let references = Self { folder: folder.into(), by_object: RwLock::default() };
        for object in library.known() {
            if references.path(object).exists()
                && let Err(error) = references.reload(object)
            {
                references.put(object, Entry::Unusable(unusable(error)?));
            }
        }
        Ok(references)
    }

    /// Reads one object's reference, if it has one.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one.
    pub fn read(folder: &Path, object: &ObjectModel) -> Result<Option<Reference>, ReferenceError> {
        let path = file_of(folder, &object.manifest.name);
        let read = || Reference::read(&path, &object.manifest.name, &object.manifest.model_sha256);
        path.exists().then(read).transpose()
    }

    /// The reference of an object, if it is calibrated.
    #[must_use]
    pub fn get(&self, object: &str) -> Option<Arc<InForce>> {
        // A map of whole references is valid whoever panicked beside it.
        match self.by_object.read().unwrap_or_else(PoisonError::into_inner).get(object)? {
            Entry::InForce(in_force) => Some(Arc::clone(in_force)),
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

    /// The file of an object's reference as it is now, where that is not the one in force: another process may have
    /// replaced it.
    #[must_use]
    pub fn changed(&self, object: &ObjectModel) -> Option<FileVersion> {
        let version = FileVersion::of(&self.path(object)).ok()?;
        let in_force = self.get(&object.manifest.name);
        in_force.is_none_or(|in_force| in_force.version != version).then_some(version)
    }

    /// Puts into force what an object's file says.
    ///
    /// # Errors
    /// [`ReferenceError`] names the file, and the field where there is one; the old reference stays in force.
    pub fn reload(&self, object: &ObjectModel) -> Result<Arc<InForce>, ReferenceError> {
        let path = self.path(object);
        // Before the file is read: what is written meanwhile is noticed later.
        let unreadable = |source| ManifestError::Read { path: path.clone(), source };
        let version = FileVersion::of(&path).map_err(unreadable)?;
        let bytes = read_bytes(&path, MAX_JSON_BYTES)?;
        let reference = Reference::parse(&path, &bytes, &object.manifest.name, &object.manifest.model_sha256)?;
        let in_force = Arc::new(InForce { reference, sha256: sha256_hex(&bytes), version });
        self.put(object, Entry::InForce(Arc::clone(&in_force)));
        Ok(in_force)
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

    /// Fails where references cannot be written.
    ///
    /// # Errors
    /// [`ReferenceError::Write`] names the folder.
    pub fn check_writable(&self) -> Result<(), ReferenceError> {
        let written = fs::create_dir_all(&self.folder).and_then(|()| tempfile::tempfile_in(&self.folder).map(drop));
        written.map_err(|source| ReferenceError::Write { path: self.folder.clone(), source })
    }

    /// Where the references lie.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn put(&self, object: &ObjectModel, entry: Entry) {
        let mut by_object = self.by_object.write().unwrap_or_else(PoisonError::into_inner);
        by_object.insert(object.manifest.name.clone(), entry);
    }

    fn path(&self, object: &ObjectModel) -> PathBuf {
        file_of(&self.folder, &object.manifest.name)
    }
}

impl FileVersion {
    fn of(path: &Path) -> std::io::Result<Self> {
        use std::os::unix::fs::MetadataExt as _;
        let metadata = fs::metadata(path)?;
        Ok(Self { modified: metadata.modified()?, bytes: metadata.len(), node: metadata.ino() })
    }
}

/// The file of an object's reference.
fn file_of(folder: &Path, object: &str) -> PathBuf {
    folder.join(format!("{object}.json"))
}

/// The images that a reference file names and that lie beside it.
fn images_of(reference: &Path) -> Vec<String> {
    #[derive(serde::Deserialize)]
    struct Names {
        references: Vec<Name>,
    }
    #[derive(serde::Deserialize)]
    struct Name {
        image: String,
    }
    let names = fs::read(reference).ok().and_then(|bytes| serde_json::from_slice::<Names>(&bytes).ok());
    let names = names.into_iter().flat_map(|names| names.references).map(|name| name.image);
    names.filter(|name| Path::new(name).file_name().is_some_and(|file| file == name.as_str())).collect()
}
