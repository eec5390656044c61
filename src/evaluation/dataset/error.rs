use std::path::PathBuf;

use thiserror::Error;

use posed_core::geometry::{CameraError, PoseError};

/// A folder or file of a dataset that cannot be read.
#[derive(Debug, Error)]
pub enum DatasetError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// The reason says where in the file.
    #[error("{}: {reason}", path.display())]
    Syntax { path: PathBuf, reason: String },
    #[error(
        "{}: no scene; one of the BOP format has scene_gt{suffix}.json and scene_camera.json, one of LINEMOD has gt.yml",
        path.display()
    )]
    NoScene { path: PathBuf, suffix: String },
    #[error("{}: no scene of the BOP format; one has scene_camera{suffix}.json and its images in rgb/ or gray/", path.display())]
    NoCameras { path: PathBuf, suffix: String },
    #[error("{}: no images; the scene is empty", path.display())]
    Empty { path: PathBuf },
    #[error(
        "{}: every '{field}' is shorter than {limit_mm} mm (the longest: {longest_mm}); this file should state millimetres, and \
         these look like metres: multiply them by 1000",
        path.display()
    )]
    Metres { path: PathBuf, field: &'static str, limit_mm: f64, longest_mm: f64 },
    #[error("{}: states no camera ('cam_K'), and there is none beside it; say which camera took the images (--camera)", path.display())]
    NoCamera { path: PathBuf },
}

/// One image of a scene that cannot be used; others can.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{}: image {image_id}: {problem}", path.display())]
pub struct ImageError {
    /// The file, or the folder of the scene.
    pub path: PathBuf,
    pub image_id: u32,
    pub problem: ImageProblem,
}

/// What is wrong with it.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ImageProblem {
    #[error("no image {0}")]
    Absent(u32),
    #[error("it is listed, but its file does not exist in {folders}")]
    NoPixels { folders: String },
    #[error("it is in {listed}, but not in this file")]
    NotListed { listed: String },
    #[error("{0}")]
    Syntax(String),
    #[error("{infos} objects, but {poses} in {listed}; the two lists must be about the same objects")]
    Lengths { infos: usize, poses: usize, listed: String },
    #[error("field 'cam_K' {0}")]
    Matrix(String),
    #[error("field 'cam_K': {0}")]
    Camera(#[source] CameraError),
    #[error(
        "fields 'cam_R_w2c' and 'cam_t_w2c' are missing: the camera's pose is not known; state the rotation (9 numbers, \
         row-major) and the translation (3 numbers, mm) that lead from the world to the camera"
    )]
    NoCameraPose,
    #[error("field '{field}' {reason}")]
    CameraPoseField { field: &'static str, reason: String },
    #[error("field 'cam_R_w2c' or 'cam_t_w2c': {0}")]
    CameraPose(#[source] PoseError),
    #[error("object {obj_id} (number {place} of its list): field '{field}' {reason}")]
    Field { obj_id: u32, place: usize, field: &'static str, reason: String },
    #[error("object {obj_id} (number {place} of its list): field 'cam_R_m2c' or 'cam_t_m2c': {source}")]
    Pose { obj_id: u32, place: usize, source: PoseError },
}
