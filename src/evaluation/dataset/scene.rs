use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::error::{DatasetError, ImageError, ImageProblem};
use super::pixels;
use crate::vision::BoundingBox;
use posed_core::geometry::{Camera, Pose};

/// No camera of a dataset is so near to an object (the least in BOP: 346 mm), and no object so far, in metres.
const METRES_BELOW_MM: f64 = 10.0;

/// A folder of images with known poses, its files parsed.
#[derive(Clone, Debug)]
pub struct Scene {
    pub path: PathBuf,
    /// The folder's name, if it is a number: targets name scenes by it.
    pub id: Option<u32>,
    pub(super) sensor: String,
    pub(super) images: BTreeMap<u32, Known>,
}

/// What a scene's files say of one image.
#[derive(Clone, Debug)]
pub(super) struct Known {
    pub(super) camera: Result<Camera, ImageError>,
    pub(super) world_from_camera: Result<Pose, ImageError>,
    pub(super) objects: Result<Vec<Annotation>, ImageError>,
}

/// An object that is said to be in an image.
#[derive(Clone, Debug)]
pub struct Annotation {
    pub obj_id: u32,
    /// An error where what is said of this object is wrong; that of others may be right.
    pub truth: Result<GroundTruth, ImageError>,
}

/// What is known of one object in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    pub obj_id: u32,
    /// Place in the image's list: masks and results of BOP are named by it.
    pub place: usize,
    pub camera_from_object: Pose,
    /// Box of the visible part, or of the whole object where the dataset states no other; `None` if nothing is seen of it.
    pub bounding_box: Option<BoundingBox>,
    /// 0..1; `None` where the dataset does not say.
    pub visible_fraction: Option<f64>,
}

/// One image of a scene, and what is known of it. Its pixels are not read yet.
#[derive(Clone, Debug)]
pub struct View {
    pub image_id: u32,
    pub image: PathBuf,
    pub camera: Camera,
    /// Pose of the camera in the scene's world; an error where it is not stated, or wrong.
    pub world_from_camera: Result<Pose, ImageError>,
    pub objects: Vec<Annotation>,
}

impl Scene {
    pub(super) fn new(path: &Path, sensor: &str, images: BTreeMap<u32, Known>) -> Result<Self, DatasetError> {
        if images.is_empty() {
            return Err(DatasetError::Empty { path: path.into() });
        }
        // A path like "." has no name of its own.
        let absolute = path.canonicalize().unwrap_or_else(|_| path.into());
        let id = absolute.file_name().and_then(|name| name.to_str()).and_then(|name| name.parse().ok());
        Ok(Self { path: path.into(), id, sensor: sensor.into(), images })
    }

    /// Numbers of the images that have ground truth (of all, if it is not read), in order.
    pub fn image_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.images.keys().copied()
    }

    /// Whether an image is said to show an object. One of which nothing can be read may show any.
    #[must_use]
    pub fn may_show(&self, image_id: u32, obj_id: u32) -> bool {
        let said = self.images.get(&image_id).map(|known| &known.objects);
        said.is_some_and(|objects| objects.as_ref().map_or(true, |all| all.iter().any(|one| one.obj_id == obj_id)))
    }

    /// One image.
    ///
    /// # Errors
    /// [`ImageError`] names the file, the image and the field. Errors of single objects are in their [`Annotation`]s.
    pub fn view(&self, image_id: u32) -> Result<View, ImageError> {
        let wrong = |problem| ImageError { path: self.path.clone(), image_id, problem };
        let known = self.images.get(&image_id).ok_or_else(|| wrong(ImageProblem::Absent(image_id)))?;
        let (objects, camera) = (known.objects.clone()?, known.camera.clone()?);
        let image = pixels::find(&self.path, &self.sensor, image_id).map_err(wrong)?;
        Ok(View { image_id, image, camera, world_from_camera: known.world_from_camera.clone(), objects })
    }
}

impl View {
    /// What is known of all instances of an object.
    ///
    /// # Errors
    /// The first error of one of them.
    pub fn truths(&self, obj_id: u32) -> Result<Vec<&GroundTruth>, ImageError> {
        let of_object = self.objects.iter().filter(|object| object.obj_id == obj_id);
        of_object.map(|object| object.truth.as_ref().map_err(Clone::clone)).collect()
    }
}

/// Refuses translations that are stated in metres: taken for millimetres they would make every estimate look wrong.
pub(super) fn check_unit(
    path: &Path,
    field: &'static str,
    distances: impl Iterator<Item = f64>,
) -> Result<(), DatasetError> {
    let longest_mm = distances.fold(0.0, f64::max);
    if longest_mm > 0.0 && longest_mm < METRES_BELOW_MM {
        let limit_mm = METRES_BELOW_MM;
        return Err(DatasetError::Metres { path: path.into(), field, limit_mm, longest_mm });
    }
    Ok(())
}
