use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::value::RawValue;

use super::error::DatasetError;

/// Scenes of LINEMOD have half a million nodes; the usual limit is there for strangers' files.
const MAX_YAML_NODES: usize = 50_000_000;

/// Values by the number of their image or object. One that is not as it should be says so, and leaves the others readable.
pub(in crate::evaluation) type ByNumber<T> = BTreeMap<u32, Result<T, String>>;

fn text(path: &Path) -> Result<String, DatasetError> {
    fs::read_to_string(path).map_err(|source| DatasetError::Read { path: path.into(), source })
}

fn syntax(path: &Path, reason: &dyn std::fmt::Display) -> DatasetError {
    DatasetError::Syntax { path: path.into(), reason: reason.to_string() }
}

pub(super) fn json<T: DeserializeOwned>(path: &Path) -> Result<T, DatasetError> {
    serde_json::from_str(&text(path)?).map_err(|error| syntax(path, &error))
}

/// A JSON file of one value for each image or object.
pub(in crate::evaluation) fn json_by_number<T: DeserializeOwned>(path: &Path) -> Result<ByNumber<T>, DatasetError> {
    let text = text(path)?;
    let values: BTreeMap<u32, &RawValue> = serde_json::from_str(&text).map_err(|error| syntax(path, &error))?;
    let value = |raw: &RawValue| serde_json::from_str(raw.get()).map_err(|error| error.to_string());
    Ok(values.into_iter().map(|(id, raw)| (id, value(raw))).collect())
}

/// A YAML file of one value for each image or object.
pub(in crate::evaluation) fn yaml_by_number<T: DeserializeOwned>(path: &Path) -> Result<ByNumber<T>, DatasetError> {
    let options = serde_saphyr::options! {
        budget: serde_saphyr::budget! { max_nodes: MAX_YAML_NODES, max_events: MAX_YAML_NODES },
        with_snippet: false,
    };
    let values: BTreeMap<u32, T> =
        serde_saphyr::from_str_with_options(&text(path)?, options).map_err(|error| syntax(path, &error))?;
    Ok(values.into_iter().map(|(id, value)| (id, Ok(value))).collect())
}
