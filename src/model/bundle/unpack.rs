//! A tar file into a folder, believing nothing of it.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Read, Write as _};
use std::path::Path;

use sha2::{Digest as _, Sha256};
use tar::{Archive, Entry, EntryType};

use super::error::BundleError;
use super::format::{BundleManifest, FileEntry, MAX_MANIFEST_BYTES};
use crate::model::manifest::hex;

const MANIFEST: &str = "bundle.json";
/// Entries of folders say nothing that the files do not.
const FOLDERS: [&str; 2] = ["detector/", "reference/"];
const CHUNK: usize = 64 << 10;

/// Unpacks a bundle, whose files may have so many bytes in all, into an empty folder. Every file lies there as it is stated, and
/// is written through to the disk; where there is an error, what lies there is worth nothing.
///
/// # Errors
/// [`BundleError`] names the file.
pub fn unpack(bundle: impl Read, folder: &Path, limit: u64) -> Result<BundleManifest, BundleError> {
    let mut archive = Archive::new(bundle);
    // Raw: headers that would rename the next file, or make it longer, are entries of a kind that is refused.
    let mut entries = archive.entries().map_err(BundleError::Tar)?.raw(true);
    let manifest = match entries.next() {
        Some(first) => read_manifest(first.map_err(BundleError::Tar)?, limit)?,
        None => return Err(BundleError::NotFirst(String::new())),
    };
    let mut written = BTreeSet::new();
    for entry in entries {
        let mut entry = entry.map_err(BundleError::Tar)?;
        let name = name_of(&entry);
        let refused = |problem: &str| BundleError::Entry { name: name.clone(), problem: problem.into() };
        let kind = entry.header().entry_type();
        if kind == EntryType::Directory && FOLDERS.contains(&name.as_str()) {
            continue;
        }
        if kind != EntryType::Regular {
            return Err(refused(&format!("is no regular file ({kind:?}); write the tar file as 'ustar'")));
        }
        let stated = manifest.files.get(&name).ok_or_else(|| refused("is not in bundle.json"))?;
        if !written.insert(name.clone()) {
            return Err(refused("is there twice"));
        }
        write(&mut entry, &name, stated, folder)?;
    }
    if let Some(name) = manifest.files.keys().find(|name| !written.contains(*name)) {
        return Err(BundleError::Missing { name: name.clone() });
    }
    check_end(archive.into_inner())?;
    Ok(manifest)
}

fn read_manifest(mut entry: Entry<'_, impl Read>, limit: u64) -> Result<BundleManifest, BundleError> {
    let name = name_of(&entry);
    if name != MANIFEST || entry.header().entry_type() != EntryType::Regular {
        return Err(BundleError::NotFirst(name));
    }
    let size = entry.header().entry_size().map_err(BundleError::Tar)?;
    if size > MAX_MANIFEST_BYTES {
        let problem = format!("has {size} bytes; at most {MAX_MANIFEST_BYTES} are allowed");
        return Err(BundleError::Entry { name, problem });
    }
    let mut text = Vec::new();
    entry.read_to_end(&mut text).map_err(BundleError::Tar)?;
    BundleManifest::parse(&text, limit)
}

/// Writes a file whose name is one of those that a bundle may have.
fn write(entry: &mut Entry<'_, impl Read>, name: &str, stated: &FileEntry, folder: &Path) -> Result<(), BundleError> {
    let refused = |problem: String| BundleError::Entry { name: name.into(), problem };
    let size = entry.header().entry_size().map_err(BundleError::Tar)?;
    if size != stated.bytes {
        return Err(refused(format!("has {size} bytes, but bundle.json states {}", stated.bytes)));
    }
    let path = folder.join(name);
    let failed = |source| BundleError::Write { path: path.clone(), source };
    fs::create_dir_all(path.parent().unwrap_or(folder)).map_err(failed)?;
    let mut file = File::create_new(&path).map_err(failed)?;
    let (mut hash, mut received, mut chunk) = (Sha256::new(), 0_u64, vec![0; CHUNK]);
    loop {
        let read = match entry.read(&mut chunk) {
            Ok(0) => break,
            Ok(read) => read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(BundleError::Tar(error)),
        };
        hash.update(&chunk[..read]);
        file.write_all(&chunk[..read]).map_err(failed)?;
        received += read as u64;
    }
    if received != stated.bytes {
        return Err(refused(format!("ends after {received} of {} bytes", stated.bytes)));
    }
    let found = hex(&hash.finalize());
    if !found.eq_ignore_ascii_case(&stated.sha256) {
        return Err(refused(format!("has sha256 {found}, but bundle.json states {}; it is damaged", stated.sha256)));
    }
    file.sync_all().map_err(failed)
}

/// What follows the last entry is padding.
fn check_end(mut rest: impl Read) -> Result<(), BundleError> {
    let mut chunk = vec![0; CHUNK];
    loop {
        match rest.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(read) if chunk[..read].iter().all(|byte| *byte == 0) => {}
            Ok(_) => return Err(BundleError::Trailing),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(BundleError::Tar(error)),
        }
    }
}

/// As it is written, which need not be a name that any file has.
fn name_of(entry: &Entry<'_, impl Read>) -> String {
    String::from_utf8_lossy(&entry.path_bytes()).into_owned()
}
