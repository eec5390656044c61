use std::path::PathBuf;

use clap::Args;

use crate::evaluation::ReadOptions;
use crate::model::{ManifestError, read_json};

/// What a dataset does not say itself.
#[derive(Args, Clone, Debug)]
pub(super) struct DatasetArgs {
    /// Sensor whose ground truth to read from a scene with several: NAME in `scene_gt_NAME.json`.
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    sensor: String,
    /// File of the camera that took the images (`*.camera.json`), for scenes without one: LINEMOD without `info.yml`.
    #[arg(long, value_name = "FILE.json")]
    camera: Option<PathBuf>,
}

impl DatasetArgs {
    pub(super) fn options(&self) -> Result<ReadOptions, ManifestError> {
        let camera = self.camera.as_deref().map(read_json).transpose()?;
        Ok(ReadOptions { sensor: self.sensor.clone(), camera, ..ReadOptions::default() })
    }
}
