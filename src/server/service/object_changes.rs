//! Objects that clients add, replace and remove.

use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::OwnedMutexGuard;

use super::allowed_changes::{AllowedChanges, ObjectTurn};
use super::change::ChangeError;
use super::failure::{Failure, FailureKind};
use super::objects::KnownObject;
use super::state::Service;
use crate::estimator::{CandidateError, load_candidate};
use crate::model::{BundleError, StoreError, unpack};

/// Waits until nobody else changes what is served.
type Changing = Box<dyn FnOnce() -> OwnedMutexGuard<()> + Send>;

/// Who comes first: whoever puts a change into force, or whoever gives it up. Dropped, it is given up.
#[derive(Clone, Default)]
struct Claim(Arc<AtomicBool>);

impl Claim {
    /// Whether it was free.
    fn take(&self) -> bool {
        !self.0.swap(true, Ordering::AcqRel)
    }
}

struct GivenUpAtLast(Claim);

impl Drop for GivenUpAtLast {
    fn drop(&mut self) {
        self.0.take();
    }
}

impl Service {
    /// Whether objects may be changed at all.
    pub(crate) fn may_change_objects(&self) -> Result<(), Failure> {
        self.object_changes().map(drop)
    }

    fn object_changes(&self) -> Result<&AllowedChanges, Failure> {
        let message = "changes of objects are off ('object_changes'); start the server with --object-changes, or use \
                       `posed objects` and --watch";
        self.object_changes.as_ref().ok_or_else(|| Failure::new(FailureKind::Forbidden, message))
    }

    /// The turn of a change, asked for before its bundle is read.
    pub(crate) fn object_turn(&self) -> Result<ObjectTurn, Failure> {
        let message = "another object is being added or removed; retry in a moment";
        self.object_changes()?.turn().ok_or_else(|| Failure::new(FailureKind::QueueFull, message))
    }

    /// Serves the object of a bundle from now on, in place of the one of its name. Blocks while `bundle` comes.
    pub(crate) async fn put_object(
        self: &Arc<Self>,
        turn: ObjectTurn,
        name: String,
        bundle: impl Read + Send + 'static,
    ) -> Result<KnownObject, Failure> {
        let (service, object) = (Arc::clone(self), name.clone());
        let put = move |changing: Changing, claim: &Claim| service.put(&object, bundle, changing, claim);
        let known = self.in_time(turn, put).await?;
        let KnownObject { model, reference, detector, .. } = &known;
        let reference = if reference.is_some() { "with a reference" } else { "without a reference" };
        let detector = if detector.is_some() { "with a detector" } else { "without a detector" };
        tracing::info!("object {name} is served, {reference}, {detector} (sha256 {})", model.manifest.model_sha256);
        Ok(known)
    }

    fn put(&self, name: &str, bundle: impl Read, changing: Changing, claim: &Claim) -> Result<KnownObject, Failure> {
        let store = &self.object_changes()?.store;
        let staged = store.stage().map_err(|error| not_written(&error))?;
        let folder = staged.folder().to_owned();
        // Paths in the scratch folder are nothing to a client.
        let scratch = format!("{}/", folder.display());
        let refused = |error: String| Failure::new(FailureKind::InvalidBundle, error.replace(&scratch, ""));
        let manifest = unpack(bundle, &folder, self.limits.max_bundle_bytes as u64).map_err(|error| match error {
            BundleError::Write { .. } => not_written(&error),
            BundleError::TooLarge { bytes, limit } => {
                let message = format!(
                    "the files have {bytes} bytes, which exceeds the limit of {limit} bytes ('max_bundle_bytes')"
                );
                Failure::new(FailureKind::TooLarge, message)
            }
            BundleError::Tar(_)
            | BundleError::NotFirst(_)
            | BundleError::Json(_)
            | BundleError::Field { .. }
            | BundleError::Version { .. }
            | BundleError::Entry { .. }
            | BundleError::Missing { .. }
            | BundleError::Trailing => refused(error.to_string()),
        })?;
        if manifest.name != name {
            return Err(refused(format!("the bundle is of object {:?}, but the path says {name:?}", manifest.name)));
        }
        let of_change = |error: ChangeError| match error {
            ChangeError::Store(error) => not_written(&error),
            ChangeError::Abandoned => {
                Failure::new(FailureKind::TimedOut, "the networks of the object took too long to load and run")
            }
            ChangeError::Candidate(_) | ChangeError::Load(_) | ChangeError::Reference(_) | ChangeError::Networks(_) => {
                refused(error.to_string())
            }
        };
        let candidate = load_candidate(&folder, &store.home(name), name, &*self.runtime);
        let object = candidate.map_err(|error| of_change(error.into()))?;
        if let Some(problem) = object.reference_problem() {
            return Err(of_change(CandidateError::StaleReference(problem.to_owned()).into()));
        }
        let library = Arc::new(self.catalogue().library.with(object));
        self.rehearse(&library).map_err(of_change)?;
        let _changing = changing();
        if !self.is_next(&library) {
            return Err(Failure::new(FailureKind::QueueFull, "the models folder changed meanwhile; retry in a moment"));
        }
        let commit = || if claim.take() { Ok(store.put(staged, name)?) } else { Err(ChangeError::Abandoned) };
        let catalogue = self.change(library, commit).map_err(of_change)?;
        let model = catalogue.library.object(name).ok_or_else(|| Failure::unknown_object(name, &catalogue.library))?;
        Ok(KnownObject::new(&catalogue, model))
    }

    /// Serves an object no longer, and removes its folder.
    pub(crate) async fn remove_object(self: &Arc<Self>, turn: ObjectTurn, name: String) -> Result<(), Failure> {
        self.model(&name)?;
        let (service, object) = (Arc::clone(self), name.clone());
        let remove = move |changing: Changing, claim: &Claim| {
            let store = &service.object_changes()?.store;
            let _changing = changing();
            service.model(&object)?;
            let commit = || match claim.take().then(|| store.remove(&object)) {
                // Somebody else has removed it.
                Some(Ok(()) | Err(StoreError::Unknown { .. })) => Ok(()),
                Some(Err(error)) => Err(error.into()),
                None => Err(ChangeError::Abandoned),
            };
            let library = Arc::new(service.catalogue().library.without(&object));
            service.change(library, commit).map(drop).map_err(|error| not_written(&error))
        };
        self.in_time(turn, remove).await?;
        tracing::info!("object {name} is removed");
        Ok(())
    }

    /// Makes a change on a thread that may block. What takes too long is left to itself, and comes into force no more.
    async fn in_time<T: Send + 'static>(
        &self,
        turn: ObjectTurn,
        change: impl FnOnce(Changing, &Claim) -> Result<T, Failure> + Send + 'static,
    ) -> Result<T, Failure> {
        let claim = Claim::default();
        let _given_up = GivenUpAtLast(claim.clone());
        let changing = Arc::clone(&self.changing);
        let of_work = claim.clone();
        let mut work = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            change(Box::new(move || changing.blocking_lock_owned()), &of_work)
        });
        let done = match tokio::time::timeout(self.limits.change_timeout, &mut work).await {
            Ok(done) => done,
            Err(_) if claim.take() => {
                let message = "the change took too long, and was given up; nothing has changed";
                return Err(Failure::new(FailureKind::TimedOut, message));
            }
            // It is in force, or will be in a moment.
            Err(_) => work.await,
        };
        done.map_err(|error| {
            tracing::error!(%error, "a change of objects failed");
            Failure::new(FailureKind::Internal, "the server failed on this change; its log has the details")
        })?
    }
}

fn not_written(error: &impl std::error::Error) -> Failure {
    tracing::error!(%error, "an object could not be changed");
    Failure::new(FailureKind::Internal, format!("{error}; nothing has changed"))
}
