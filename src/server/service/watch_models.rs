//! Models that somebody else changes: `posed objects`, a copied folder, or a second server on the same one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::change::ChangeError;
use super::state::Service;
use crate::estimator::load_candidate;
use crate::model::{DETECTOR, DetectorModel, FolderVersion, Library, LoadError, ObjectModel};

/// A look at the times of some dozens of files costs nothing.
const PERIOD: Duration = Duration::from_secs(2);

/// What was seen of the folder so far.
#[derive(Default)]
struct Seen {
    /// Changes that were there at the last look: a copy that is still being written looks different at the next one.
    pending: BTreeMap<String, FolderVersion>,
    /// Changes that could not be served, each told of once.
    refused: BTreeMap<String, FolderVersion>,
    /// Whether the folder itself could be read.
    unreadable: bool,
}

/// Keeps looking for changes, where that is wanted, until the server is gone. What cannot be served changes nothing.
pub(crate) fn watch_models(service: &Arc<Service>) {
    if !service.watch {
        return;
    }
    let service = Arc::downgrade(service);
    let look = move || {
        let mut seen = Seen::default();
        while let Some(service) = service.upgrade() {
            seen.look(&service, &service.models);
            drop(service);
            std::thread::sleep(PERIOD);
        }
    };
    if let Err(error) = std::thread::Builder::new().name("models".into()).spawn(look) {
        tracing::error!("the models folder is not watched: {error}");
    }
}

impl Seen {
    fn look(&mut self, service: &Service, models: &Path) {
        let there = match folders(models, &service.catalogue().library) {
            Ok(there) => there,
            Err(error) => {
                if !std::mem::replace(&mut self.unreadable, true) {
                    tracing::error!("{error}; what is served remains");
                }
                return;
            }
        };
        self.unreadable = false;
        let library = Arc::clone(&service.catalogue().library);
        let served = library.known().map(|object| object.manifest.name.clone());
        let names: BTreeSet<String> = there.iter().cloned().chain(served).chain([DETECTOR.to_owned()]).collect();
        for name in names {
            let now = version_there(models, &name, &there);
            if now == version_served(&library, &name) {
                self.pending.remove(&name);
                self.refused.remove(&name);
            } else if self.refused.get(&name) == Some(&now) {
                self.pending.remove(&name);
            } else if self.pending.get(&name) == Some(&now) {
                self.pending.remove(&name);
                self.apply(service, models, name, now, &there);
            } else {
                self.pending.insert(name, now);
            }
        }
    }

    fn apply(&mut self, service: &Service, models: &Path, name: String, now: FolderVersion, there: &BTreeSet<String>) {
        let library = Arc::clone(&service.catalogue().library);
        let before = library.object(&name).is_some();
        let (what, next) = if name == DETECTOR {
            ("the shared detector was changed", library.with_shared_detector(models).map_err(ChangeError::from))
        } else if there.contains(&name) {
            let folder = models.join(&name);
            let object = load_candidate(&folder, &folder, &name, &*service.runtime).map_err(ChangeError::from);
            (if before { "was replaced" } else { "was added" }, object.map(|object| library.with(object)))
        } else {
            ("was removed", Ok(library.without(&name)))
        };
        let next = next.map(Arc::new).and_then(|next| service.rehearse(&next).map(|()| next));
        let _changing = service.changing.blocking_lock();
        if service.catalogue().library.generation() != library.generation() {
            // A client changed something: what is to be done shows at the next look.
            return;
        }
        match next.and_then(|next| service.change(next, || Ok(()))) {
            Ok(catalogue) => {
                tracing::info!("{}: {name} {what}; objects: {}", models.display(), known(&catalogue.library));
                service.notes().iter().for_each(|note| tracing::warn!("{note}"));
            }
            Err(error) => {
                tracing::error!(
                    "{name} changed in the models folder, but cannot be served: {error}; the old one remains"
                );
                self.refused.insert(name, now);
            }
        }
    }
}

/// The objects that lie in the folder. One that is empty all of a sudden is no longer there itself.
fn folders(models: &Path, library: &Library) -> Result<BTreeSet<String>, LoadError> {
    let there: BTreeSet<String> = Library::folders(models)?.into_iter().collect();
    let nothing = there.is_empty() && !models.join(DETECTOR).is_dir();
    if nothing && library.known().count() > 1 { Err(LoadError::Empty { path: models.into() }) } else { Ok(there) }
}

fn version_there(models: &Path, name: &str, there: &BTreeSet<String>) -> FolderVersion {
    let is_there = name == DETECTOR || there.contains(name);
    if is_there { FolderVersion::of(&models.join(name)) } else { FolderVersion::default() }
}

fn version_served(library: &Library, name: &str) -> FolderVersion {
    let version = if name == DETECTOR {
        library.shared_detector().map(|detector| DetectorModel::version(detector))
    } else {
        library.object(name).map(|object| ObjectModel::version(object))
    };
    version.cloned().unwrap_or_default()
}

fn known(library: &Library) -> String {
    library.known().map(|object| object.manifest.name.as_str()).collect::<Vec<_>>().join(", ")
}
