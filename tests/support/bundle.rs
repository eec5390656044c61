//! Bundles of the shipped objects, and spoilt ones.
#![allow(dead_code, unreachable_pub, reason = "each test file uses a part of this")]

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tar::{EntryType, Header};

use crate::support::{read, root};

/// The files of a bundle, by name.
#[derive(Clone)]
pub struct Bundle {
    pub name: String,
    pub files: BTreeMap<String, Vec<u8>>,
}

pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}"))
}

/// Makes a `parity.json` say that every keypoint lies elsewhere.
pub fn move_keypoints(parity: &mut Value) {
    for keypoint in
        parity["keypoints_px"].as_array_mut().unwrap().iter_mut().flat_map(|crop| crop.as_array_mut().unwrap())
    {
        keypoint[0] = 500.into();
    }
}

impl Bundle {
    /// A shipped object with its reference and a detector that knows it alone.
    pub fn of(name: &str) -> Self {
        let mut bundle = Self { name: name.into(), files: BTreeMap::new() };
        let object = root().join("models").join(name);
        for file in ["object.json", "keypoints.onnx", "parity.json", "parity.png"] {
            bundle.add(file, read(&object.join(file)));
        }
        let detector = root().join("models/detector");
        bundle.add("detector/detector.onnx", read(&detector.join("detector.onnx")));
        bundle.add("detector/detector.json", read(&detector.join("detector.json")));
        bundle.change("detector/detector.json", |json| {
            for label in json["labels"].as_array_mut().unwrap().iter_mut().filter(|label| *label != name) {
                *label = Value::Null;
            }
        });
        let reference = root().join("reference").join(format!("{name}.json"));
        bundle.add("reference.json", read(&reference));
        let views: Value = serde_json::from_slice(&read(&reference)).unwrap();
        for view in views["references"].as_array().unwrap() {
            let image = view["image"].as_str().unwrap();
            bundle.add(&format!("reference/{image}"), read(&root().join("reference").join(image)));
        }
        bundle.add("NOTICE", b"For tests.".to_vec());
        bundle
    }

    pub fn add(&mut self, name: &str, bytes: Vec<u8>) {
        self.files.insert(name.into(), bytes);
    }

    pub fn without(mut self, names: &[&str]) -> Self {
        self.files.retain(|name, _| !names.iter().any(|gone| name.starts_with(gone)));
        self
    }

    /// Changes one of its JSON files.
    pub fn change(&mut self, name: &str, change: impl FnOnce(&mut Value)) {
        let mut json: Value = serde_json::from_slice(&self.files[name]).unwrap();
        change(&mut json);
        self.add(name, json.to_string().into_bytes());
    }

    pub fn manifest(&self) -> Value {
        let file = |bytes: &Vec<u8>| json!({"bytes": bytes.len(), "sha256": sha256(bytes)});
        let files: BTreeMap<&String, Value> = self.files.iter().map(|(name, bytes)| (name, file(bytes))).collect();
        json!({"format": "posed-bundle", "version": 1, "name": self.name, "files": files})
    }

    pub fn tar(&self) -> Vec<u8> {
        self.tar_with(&self.manifest(), &[])
    }

    /// With another manifest, and further entries behind its files.
    pub fn tar_with(&self, manifest: &Value, more: &[Entry]) -> Vec<u8> {
        let manifest = manifest.to_string().into_bytes();
        let mut entries = vec![Entry::file("bundle.json", &manifest)];
        entries.extend(self.files.iter().map(|(name, bytes)| Entry::file(name, bytes)));
        entries.extend(more.iter().cloned());
        tar(&entries)
    }

    /// Its files as a folder.
    pub fn write(&self, folder: &Path) {
        for (name, bytes) in &self.files {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
    }
}

/// One entry of a tar file, whatever its name.
#[derive(Clone)]
pub struct Entry {
    name: String,
    kind: EntryType,
    link: String,
    bytes: Vec<u8>,
}

impl Entry {
    pub fn file(name: &str, bytes: &[u8]) -> Self {
        Self { name: name.into(), kind: EntryType::Regular, link: String::new(), bytes: bytes.into() }
    }

    pub fn link(name: &str, kind: EntryType, to: &str) -> Self {
        Self { name: name.into(), kind, link: to.into(), bytes: Vec::new() }
    }
}

/// A tar file. The crate's own builder would refuse some of these names.
pub fn tar(entries: &[Entry]) -> Vec<u8> {
    let mut tar = Vec::new();
    for Entry { name, kind, link, bytes } in entries {
        let mut header = Header::new_ustar();
        let raw = header.as_mut_bytes();
        raw[..name.len()].copy_from_slice(name.as_bytes());
        raw[157..157 + link.len()].copy_from_slice(link.as_bytes());
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        header.set_entry_type(*kind);
        header.set_cksum();
        tar.extend_from_slice(header.as_bytes());
        tar.extend_from_slice(bytes);
        tar.resize(tar.len().next_multiple_of(512), 0);
    }
    tar.resize(tar.len() + 1024, 0);
    tar
}
