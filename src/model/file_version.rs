//! What changes when files do: looked at often, and without reading them.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// What changes when a file does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileVersion {
    pub modified: SystemTime,
    bytes: u64,
    /// A file that is renamed to this name within the clock's resolution is another one.
    node: u64,
}

impl FileVersion {
    pub(super) fn of(path: &Path) -> io::Result<Self> {
        use std::os::unix::fs::MetadataExt as _;
        let metadata = fs::metadata(path)?;
        Ok(Self { modified: metadata.modified()?, bytes: metadata.len(), node: metadata.ino() })
    }
}

/// What changes when a file in a folder, or in a folder in it, does. Moving the folder changes nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FolderVersion(BTreeMap<PathBuf, FileVersion>);

/// An object's folder has a folder for its detector and one for reference images.
const MAX_DEPTH: usize = 1;

impl FolderVersion {
    /// A folder that is not there has no files.
    #[must_use]
    pub fn of(folder: &Path) -> Self {
        let mut files = BTreeMap::new();
        // What cannot be read now is noticed when it can.
        let _ = collect(folder, Path::new(""), MAX_DEPTH, &mut files);
        Self(files)
    }
}

fn collect(folder: &Path, below: &Path, depth: usize, files: &mut BTreeMap<PathBuf, FileVersion>) -> io::Result<()> {
    for entry in fs::read_dir(folder.join(below))? {
        let name = below.join(entry?.file_name());
        let path = folder.join(&name);
        if !path.is_dir() {
            files.insert(name, FileVersion::of(&path)?);
        } else if depth > 0 {
            collect(folder, &name, depth - 1, files)?;
        }
    }
    Ok(())
}
