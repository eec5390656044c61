//! Manifests and references, as they lie on disk. The first byte says which.
#![no_main]

use libfuzzer_sys::fuzz_target;
use posed::model::{DetectorManifest, KeypointManifest, Reference};

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, text)) = bytes.split_first() else { return };
    let file = tempfile::NamedTempFile::new().expect("a temporary file");
    std::fs::write(file.path(), text).expect("a temporary file");
    match kind % 3 {
        0 => drop(DetectorManifest::read(file.path())),
        1 => {
            if let Ok(manifest) = KeypointManifest::read(file.path()) {
                let _ = manifest.symmetries();
            }
        }
        _ => drop(Reference::read(file.path(), "cube", &"0".repeat(64))),
    }
});
