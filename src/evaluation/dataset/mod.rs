//! Images with known poses, as datasets of the field store them: the BOP format and the layouts of LINEMOD.
//! Millimetres become metres here and in [`super::ObjectMesh`], and nowhere else.

mod bop;
mod entry;
mod error;
mod file;
mod linemod;
mod pixels;
mod scene;
mod split;
mod targets;

pub use error::{DatasetError, ImageError, ImageProblem};
pub(super) use file::{ByNumber, json_by_number, yaml_by_number};
pub use scene::{Annotation, GroundTruth, Scene, View};
pub use split::{ReadOptions, SceneFolder, scenes};
pub use targets::{Target, Targets};
