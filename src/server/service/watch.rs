//! References that another process replaces: `posed calibrate`, or a second server on the same folder.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use crate::model::{Library, References};

/// A look at a few files' times costs nothing.
const PERIOD: Duration = Duration::from_secs(2);

/// Keeps looking, until the references are gone. A file that cannot be used is told of once; the old reference stays in
/// force, as it does where a file vanishes.
pub(super) fn references(references: &Arc<References>, library: &Arc<Library>) {
    let (references, library) = (Arc::downgrade(references), Arc::downgrade(library));
    let mut refused = BTreeMap::new();
    let look = move || {
        while let (Some(references), Some(library)) = (references.upgrade(), library.upgrade()) {
            for object in library.known() {
                let name = &object.manifest.name;
                let Some(version) = references.changed(object) else { continue };
                if refused.get(name) == Some(&version) {
                    continue;
                }
                match references.reload(object) {
                    Ok(new) => tracing::info!("{name} has a new reference (sha256 {})", new.sha256),
                    Err(error) => {
                        tracing::error!("{error}; the old reference remains in use");
                        refused.insert(name.clone(), version);
                    }
                }
            }
            drop((references, library));
            std::thread::sleep(PERIOD);
        }
    };
    if let Err(error) = std::thread::Builder::new().name("references".into()).spawn(look) {
        tracing::error!("references are not watched: {error}");
    }
}
