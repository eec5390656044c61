//! The images of references, for people who check them.

use std::path::Path;
use std::sync::Arc;

use super::failure::{Failure, FailureKind};
use super::state::Service;
use crate::estimator::BodyLease;
use crate::model::read_regular;

/// A file of an image that a reference was measured on.
pub(crate) struct ReferenceImage {
    pub bytes: Vec<u8>,
    pub content_type: &'static str,
    /// Until it has left.
    pub room: Arc<BodyLease>,
}

impl Service {
    /// An image of the reference in force, by its file name. It takes room as a body does.
    pub(crate) async fn reference_image(&self, object: &str, image: &str) -> Result<ReferenceImage, Failure> {
        let gone = || {
            let message = format!("the reference of {object:?} has no image {image:?}; GET /v1/objects lists them");
            Failure::new(FailureKind::NotFound, message)
        };
        let reference = self.object(object)?.reference.ok_or_else(gone)?;
        // A reference file that was tampered with must not lead out of its folder.
        let is_name = |name: &str| Path::new(name).file_name().is_some_and(|file| file == name);
        let known = reference.reference.views.iter().any(|view| view.image == image && is_name(image));
        let path = known.then(|| reference.images.join(image)).ok_or_else(gone)?;
        let read = tokio::task::spawn_blocking({
            let bytes = path.metadata().map_err(|_| gone())?.len();
            let size = usize::try_from(bytes).unwrap_or(usize::MAX);
            let room = self.queue.admission().body(size).map_err(|refusal| self.refused(refusal))?;
            move || (read_regular(&path, bytes), Arc::new(room))
        });
        let (bytes, room) = read.await.map_err(|_| gone())?;
        let bytes = bytes.map_err(|_| gone())?;
        // What is no image is not shown: the folder is the operator's, its files may be anything.
        let format = image::guess_format(&bytes).map_err(|_| gone())?;
        Ok(ReferenceImage { bytes, content_type: format.to_mime_type(), room })
    }
}
