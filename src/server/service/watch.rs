//! References that another process replaces: `posed calibrate`, or a second server on the same folder.

use std::sync::Arc;
use std::time::Duration;

use crate::model::Current;

/// A look at a few files' times costs nothing.
const PERIOD: Duration = Duration::from_secs(2);

/// Keeps looking, until the objects are gone. A file that cannot be used is told of once; the old reference stays in
/// force, as it does where a file vanishes.
pub(super) fn references(current: &Arc<Current>) {
    let current = Arc::downgrade(current);
    let look = move || {
        while let Some(catalogue) = current.upgrade().map(|current| current.get()) {
            for object in catalogue.library.known().filter(|object| catalogue.references.has_changed(object)) {
                let name = &object.manifest.name;
                match catalogue.references.reload(object) {
                    Ok(new) => tracing::info!("{name} has a new reference (sha256 {})", new.sha256),
                    Err(error) => tracing::error!("{error}; the old reference remains in use"),
                }
            }
            drop(catalogue);
            std::thread::sleep(PERIOD);
        }
    };
    if let Err(error) = std::thread::Builder::new().name("references".into()).spawn(look) {
        tracing::error!("references are not watched: {error}");
    }
}
