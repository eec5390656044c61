//! `bundle.json`, and which files a bundle may have.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::VERSION;
use super::error::BundleError;
use crate::model::manifest::{MAX_MODEL_BYTES, check_name};
use crate::model::object::DETECTOR;

const FORMAT: &str = "posed-bundle";
/// Larger ones name more files than there can be.
pub(super) const MAX_MANIFEST_BYTES: u64 = 64 << 10;
const MAX_JSON_BYTES: u64 = 4 << 20;
const MAX_PICTURE_BYTES: u64 = 16 << 20;
const MAX_NOTICE_BYTES: u64 = 1 << 20;
const MAX_REFERENCE_IMAGES: usize = 64;
const MAX_FILE_NAME: usize = 100;
const IMAGE_ENDINGS: [&str; 4] = ["jpg", "jpeg", "png", "webp"];
const REFERENCE_IMAGES: &str = "reference/";
/// Files that come together, or not at all.
const PAIRS: [[&str; 2]; 2] = [["parity.json", "parity.png"], ["detector/detector.json", "detector/detector.onnx"]];

/// `bundle.json`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BundleManifest {
    #[serde(rename = "format")]
    _format: String,
    #[serde(rename = "version")]
    _version: u32,
    /// Of the object.
    pub name: String,
    pub(super) files: BTreeMap<String, FileEntry>,
    /// For people.
    #[serde(rename = "made_by", default)]
    _made_by: Option<String>,
}

/// A file as it is stated.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FileEntry {
    pub bytes: u64,
    pub sha256: String,
}

impl BundleManifest {
    /// Reads `bundle.json` of a bundle whose files may have so many bytes in all.
    pub(super) fn parse(text: &[u8], limit: u64) -> Result<Self, BundleError> {
        // Fields may differ from version to version, so the version comes first.
        let value: Value = serde_json::from_slice(text)?;
        let invalid = |field, problem| BundleError::Field { field, problem };
        if value.get("format").and_then(Value::as_str) != Some(FORMAT) {
            return Err(invalid("format", format!("is not {FORMAT:?}")));
        }
        let version = value.get("version").and_then(Value::as_u64);
        match version.ok_or_else(|| invalid("version", "is no whole number".into()))? {
            version if version == u64::from(VERSION) => {}
            found => return Err(BundleError::Version { found }),
        }
        let manifest: Self = serde_json::from_value(value)?;
        manifest.check(limit)?;
        Ok(manifest)
    }

    fn check(&self, limit: u64) -> Result<(), BundleError> {
        let invalid = |field, problem| BundleError::Field { field, problem };
        check_name(&self.name).map_err(|problem| invalid("name", problem))?;
        if self.name == DETECTOR {
            return Err(invalid("name", format!("is {:?}, the folder of the shared detector", self.name)));
        }
        for (name, file) in &self.files {
            let entry = |problem: &str| BundleError::Entry { name: name.clone(), problem: problem.into() };
            let most = most_bytes(name).ok_or_else(|| entry("is no file of a bundle; see docs/bundle.md"))?;
            if file.bytes > most {
                let problem = format!("has {} bytes by bundle.json; at most {most} are allowed", file.bytes);
                return Err(BundleError::Entry { name: name.clone(), problem });
            }
        }
        let bytes = self.files.values().fold(0_u64, |sum, file| sum.saturating_add(file.bytes));
        if bytes > limit {
            return Err(BundleError::TooLarge { bytes, limit });
        }
        let has = |name: &str| self.files.contains_key(name);
        if let Some(missing) = ["object.json", "keypoints.onnx"].into_iter().find(|name| !has(name)) {
            return Err(invalid("files", format!("does not have {missing:?}")));
        }
        if let Some([first, second]) = PAIRS.into_iter().find(|[first, second]| has(first) != has(second)) {
            return Err(invalid("files", format!("has one of {first:?} and {second:?}; they come together")));
        }
        let images = self.files.keys().filter(|name| name.starts_with(REFERENCE_IMAGES)).count();
        if images > MAX_REFERENCE_IMAGES {
            return Err(invalid("files", format!("has {images} reference images; at most {MAX_REFERENCE_IMAGES}")));
        }
        if images > 0 && !has("reference.json") {
            return Err(invalid("files", "has reference images, but no \"reference.json\"".into()));
        }
        Ok(())
    }
}

/// How large a file of this name may be; `None` where a bundle has no such file.
fn most_bytes(name: &str) -> Option<u64> {
    match name {
        "object.json" | "parity.json" | "reference.json" | "detector/detector.json" => Some(MAX_JSON_BYTES),
        "keypoints.onnx" | "detector/detector.onnx" => Some(MAX_MODEL_BYTES),
        "parity.png" | "report.html" => Some(MAX_PICTURE_BYTES),
        "NOTICE" => Some(MAX_NOTICE_BYTES),
        _ => name.strip_prefix(REFERENCE_IMAGES).filter(|file| is_image_name(file)).map(|_| MAX_PICTURE_BYTES),
    }
}

fn is_image_name(file: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || ['_', '-', '.'].contains(&c);
    let ending = file.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
    (1..=MAX_FILE_NAME).contains(&file.len())
        && file.chars().all(allowed)
        && !file.starts_with('.')
        && ending.is_some_and(|ending| IMAGE_ENDINGS.contains(&ending.as_str()))
}
