use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::dataset::{ByNumber, DatasetError, json_by_number, yaml_by_number};
use posed_core::geometry::{BopAxis, BopSymmetries};

const JSON: &str = "models_info.json";
const YAML: &str = "models_info.yml";
/// No dataset is of objects that are all so small; in metres, all objects of BOP are smaller.
const METRES_BELOW_MM: f64 = 2.0;

/// `models_info.json`, or `models_info.yml` of LINEMOD.
pub(super) struct ModelsInfo {
    pub(super) path: PathBuf,
    pub(super) objects: ByNumber<ModelInfo>,
}

#[derive(Deserialize)]
pub(super) struct ModelInfo {
    pub(super) diameter: Option<f64>,
    #[serde(default)]
    symmetries_discrete: Vec<[f64; 16]>,
    #[serde(default)]
    symmetries_continuous: Vec<BopAxis>,
}

impl ModelsInfo {
    pub(super) fn is_in(folder: &Path) -> bool {
        [JSON, YAML].iter().any(|name| folder.join(name).is_file())
    }

    pub(super) fn read(folder: &Path) -> Result<Self, DatasetError> {
        let yaml = folder.join(YAML);
        let json = folder.join(JSON);
        let (path, objects) = if yaml.is_file() && !json.is_file() {
            (yaml.clone(), yaml_by_number::<ModelInfo>(&yaml)?)
        } else {
            (json.clone(), json_by_number::<ModelInfo>(&json)?)
        };
        let longest_mm = objects.values().flatten().filter_map(|object| object.diameter).fold(0.0, f64::max);
        if longest_mm > 0.0 && longest_mm < METRES_BELOW_MM {
            return Err(DatasetError::Metres { path, field: "diameter", limit_mm: METRES_BELOW_MM, longest_mm });
        }
        Ok(Self { path, objects })
    }
}

impl ModelInfo {
    pub(super) fn symmetries(&self) -> BopSymmetries {
        BopSymmetries {
            symmetries_discrete: self.symmetries_discrete.clone(),
            symmetries_continuous: self.symmetries_continuous.clone(),
        }
    }
}
