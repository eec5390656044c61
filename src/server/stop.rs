//! The word that the server stops: no further request is begun.

use tokio::sync::watch;

/// Waits until the server stops.
pub(super) async fn stopped(mut stopping: watch::Receiver<bool>) {
    // An error means that the sender is gone, and so is the program.
    let _ = stopping.wait_for(|stop| *stop).await;
}
