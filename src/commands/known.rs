use std::path::{Path, PathBuf};

use crate::vision::BoundingBox;
use posed_core::geometry::{Camera, Pose};

/// A reference image with what is known of it.
pub(super) struct Known {
    pub(super) path: PathBuf,
    pub(super) camera: Camera,
    pub(super) camera_from_object: Pose,
    pub(super) region: BoundingBox,
}

/// An image whose path is relative to the file that names it.
pub(super) fn beside(file: &Path, image: &Path) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(image)
}
