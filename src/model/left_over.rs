//! Files that a program left in a folder of references when it was killed while it wrote.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// A file younger than this may be another replica's, which is about to name it.
const YOUNG: Duration = Duration::from_hours(1);
/// Of the hash in an image's name.
const HASH_DIGITS: usize = 12;

/// Removes temporary files, and images with names as they are given here that no reference names. What cannot be removed does
/// no harm.
pub(super) fn sweep(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let entries: Vec<_> = entries.flatten().collect();
    let named: BTreeSet<String> = entries.iter().flat_map(|entry| images_of(&entry.path())).collect();
    let old = |modified: SystemTime| modified.elapsed().is_ok_and(|age| age > YOUNG);
    for entry in entries {
        let Ok(name) = entry.file_name().into_string() else { continue };
        let is_ours = name.starts_with(".tmp") || (is_image_name(&name) && !named.contains(&name));
        let is_old = || entry.metadata().is_ok_and(|data| data.is_file() && data.modified().is_ok_and(old));
        if is_ours && is_old() && fs::remove_file(entry.path()).is_ok() {
            tracing::info!("{}: {name}, left over, was removed", folder.display());
        }
    }
}

fn is_image_name(name: &str) -> bool {
    let stem = Path::new(name).file_stem().and_then(|stem| stem.to_str());
    let hash = stem.and_then(|stem| stem.rsplit_once('-')).map(|(_, hash)| hash);
    hash.is_some_and(|hash| hash.len() == HASH_DIGITS && hash.bytes().all(|digit| digit.is_ascii_hexdigit()))
}

/// The images that a reference file names and that lie beside it.
pub(super) fn images_of(reference: &Path) -> Vec<String> {
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
