//! What clients may change objects with.

use std::path::Path;
use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::model::{Store, StoreError};

/// There where clients may change objects.
pub(super) struct AllowedChanges {
    pub(super) store: Store,
    /// One bundle at a time: they may be large.
    turn: Arc<Semaphore>,
}

/// The turn of a change, until it is made.
pub(crate) struct ObjectTurn(#[expect(dead_code, reason = "held, not read")] OwnedSemaphorePermit);

impl AllowedChanges {
    /// # Errors
    /// When the folder cannot be written to.
    pub(super) fn at(models: &Path) -> Result<Self, StoreError> {
        let store = Store::at(models);
        store.check_writable()?;
        store.tidy();
        Ok(Self { store, turn: Arc::new(Semaphore::new(1)) })
    }

    /// `None` where somebody else has it.
    pub(super) fn turn(&self) -> Option<ObjectTurn> {
        Arc::clone(&self.turn).try_acquire_owned().ok().map(ObjectTurn)
    }
}
