//! The models folder as it is changed: an object's folder comes and goes whole.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::io::Errno;
use tempfile::TempDir;
use thiserror::Error;

/// A models folder whose objects may be changed.
#[derive(Clone, Debug)]
pub struct Store {
    models: PathBuf,
}

/// An object's folder that is made ready beside the others. Dropped, it is gone.
pub struct Staged {
    scratch: TempDir,
    folder: PathBuf,
}

/// A change that could not be made. Nothing has changed.
#[derive(Debug, Error)]
pub enum StoreError {
    #[error("cannot write to the models folder {}: {source}; it must be writable where objects are to be changed", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("cannot put {} into place: {source}", path.display())]
    Swap { path: PathBuf, source: io::Error },
    #[error("there is no object {name:?} in {}", path.display())]
    Unknown { name: String, path: PathBuf },
}

/// What is being made ready is hidden, as for everybody who looks for objects.
const SCRATCH: &str = ".incoming-";
/// An object's folder that is to be removed.
const AWAY: &str = "away";
/// The folder of an object between two renames, by its name.
const BEFORE: &str = "before";
/// What is older was left behind by a program that was killed.
const LEFT_BEHIND: Duration = Duration::from_hours(1);

impl Store {
    #[must_use]
    pub fn at(models: &Path) -> Self {
        Self { models: models.into() }
    }

    /// Fails where objects cannot be changed.
    ///
    /// # Errors
    /// [`StoreError::Write`] names the folder.
    pub fn check_writable(&self) -> Result<(), StoreError> {
        let written = fs::create_dir_all(&self.models).and_then(|()| tempfile::tempfile_in(&self.models).map(drop));
        written.map_err(|source| StoreError::Write { path: self.models.clone(), source })
    }

    /// Where an object's folder lies.
    #[must_use]
    pub fn home(&self, name: &str) -> PathBuf {
        self.models.join(name)
    }

    /// An empty folder for an object, to be filled.
    ///
    /// # Errors
    /// [`StoreError::Write`] names the folder.
    pub fn stage(&self) -> Result<Staged, StoreError> {
        let failed = |source| StoreError::Write { path: self.models.clone(), source };
        fs::create_dir_all(&self.models).map_err(failed)?;
        let scratch = tempfile::Builder::new().prefix(SCRATCH).tempdir_in(&self.models).map_err(failed)?;
        let folder = scratch.path().join("object");
        fs::create_dir(&folder).map_err(failed)?;
        Ok(Staged { scratch, folder })
    }

    /// Puts a folder into place, by one rename. That of the object before is gone then.
    ///
    /// # Errors
    /// [`StoreError::Swap`]; the old folder is in place then, as it was.
    pub fn put(&self, staged: Staged, name: &str) -> Result<(), StoreError> {
        let home = self.home(name);
        let swapped = sync_folders(&staged.folder).and_then(|()| swap(&staged, &home));
        // With it goes what was there before.
        drop(staged);
        swapped.and_then(|()| sync(&self.models)).map_err(|source| StoreError::Swap { path: home, source })
    }

    /// Removes an object's folder, by one rename.
    ///
    /// # Errors
    /// [`StoreError`] says why it is still there.
    pub fn remove(&self, name: &str) -> Result<(), StoreError> {
        let home = self.home(name);
        if !home.is_dir() {
            return Err(StoreError::Unknown { name: name.into(), path: self.models.clone() });
        }
        let away = self.stage()?;
        let renamed = fs::rename(&home, away.scratch.path().join(AWAY)).and_then(|()| sync(&self.models));
        renamed.map_err(|source| StoreError::Swap { path: home, source })
    }

    /// Clears away what a program left behind that was killed while it changed something.
    pub fn tidy(&self) {
        for entry in fs::read_dir(&self.models).into_iter().flatten().flatten() {
            let is_scratch = entry.file_name().to_string_lossy().starts_with(SCRATCH);
            let age = entry
                .metadata()
                .and_then(|metadata| metadata.modified())
                .map(|time| SystemTime::now().duration_since(time).unwrap_or_default());
            if is_scratch {
                self.restore(&entry.path().join(BEFORE));
            }
            if is_scratch && age.is_ok_and(|age| age > LEFT_BEHIND) {
                // A folder too many does no harm.
                let _ = fs::remove_dir_all(entry.path());
            }
        }
    }
}

impl Store {
    /// Puts back what was taken away for another folder that never came.
    fn restore(&self, before: &Path) {
        for entry in fs::read_dir(before).into_iter().flatten().flatten() {
            let home = self.models.join(entry.file_name());
            if !home.exists() {
                // Whoever looks for the object says that it is gone.
                let _ = fs::rename(entry.path(), home);
            }
        }
    }
}

impl Staged {
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

fn swap(staged: &Staged, home: &Path) -> io::Result<()> {
    if !home.exists() {
        return fs::rename(&staged.folder, home);
    }
    match renameat_with(CWD, &staged.folder, CWD, home, RenameFlags::EXCHANGE) {
        Ok(()) => Ok(()),
        // File systems that cannot exchange two folders: for a moment there is none.
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {
            let before = staged.scratch.path().join(BEFORE).join(home.file_name().unwrap_or_default());
            fs::create_dir_all(before.parent().unwrap_or(home))?;
            fs::rename(home, &before)?;
            fs::rename(&staged.folder, home).inspect_err(|_| {
                let _ = fs::rename(&before, home);
            })
        }
        Err(error) => Err(error.into()),
    }
}

/// That what was written is there after a crash.
fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// A folder and those in it.
fn sync_folders(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            sync_folders(&path)?;
        }
    }
    sync(folder)
}
