//! From the answers to several images of one scene to one pose of each object in it.

mod cameras;
mod elsewhere;
mod fuse;
mod fused;
mod instance;
mod keypoints_scale;
mod picture;

pub use cameras::{CamerasError, cameras_are_meant};
pub use fuse::fuse;
pub use fused::{FusedPose, LeftOut, PosedCamera, ViewShare};
pub use keypoints_scale::{LocatedView, fit_offset_and_scale};
pub use picture::ViewsPicture;
