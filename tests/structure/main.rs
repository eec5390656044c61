//! The structure of the sources: arrows run one way, from file to file and from folder to folder; files are small.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod circles;
mod itself;
mod tree;
mod uses;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use circles::circles;
use tree::Tree;
use uses::{Use, uses};

const CRATES: [(&str, &str); 3] =
    [("posed", "src/lib.rs"), ("posed_core", "core/src/lib.rs"), ("the program", "src/main.rs")];
/// Where files of Rust lie.
const FOLDERS: [&str; 6] = ["src", "tests", "benches", "core/src", "core/tests", "core/benches"];
const MAX_LINES: usize = 450;
const MAX_MEDIAN_LINES: usize = 150;

/// Folders, and the files, folders and crates that they must not know.
const LAYERS: [(&[&str], &[&str]); 5] = [
    (&["core/src"], &["src", "clap", "image", "ort", "tokio", "utoipa"]),
    (
        &["src/vision", "src/model", "src/estimator", "src/evaluation"],
        &["src/server", "src/commands", "src/proto.rs", "axum", "prometheus_client", "tonic", "utoipa"],
    ),
    (&["src/vision"], &["src/model", "src/estimator", "src/evaluation", "ort", "tokio"]),
    (&["src/model"], &["src/estimator", "src/evaluation"]),
    (&["src/server"], &["src/commands"]),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn no_file_uses_one_that_uses_it() {
    let found = circles(&uses(&Tree::read(root(), &CRATES)));
    assert!(found.is_empty(), "{} circles\n{}", found.len(), found.join("\n"));
}

#[test]
fn each_folder_knows_only_those_below_it() {
    let found = breaches(&uses(&Tree::read(root(), &CRATES)), &LAYERS);
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Uses of what a table forbids, even if only a re-export there leads back to what is allowed.
fn breaches(uses: &BTreeSet<Use>, layers: &[(&[&str], &[&str])]) -> Vec<String> {
    let mut found = Vec::new();
    for one in uses {
        let inside = |folders: &[&str]| folders.iter().any(|folder| one.file.starts_with(folder));
        for forbidden in layers.iter().filter(|(folders, _)| inside(folders)).flat_map(|(_, all)| *all) {
            if one.through.iter().chain([&one.of]).any(|file| file.starts_with(forbidden)) {
                found.push(format!("{} uses {} of {forbidden}", one.file.display(), one.name));
            }
        }
    }
    found
}

/// A file that no `mod` names would be in no other test here.
#[test]
fn every_file_was_read() {
    let tree = Tree::read(root(), &CRATES);
    let read = tree.modules.iter().map(|module| module.file.clone());
    let read: BTreeSet<_> = read.chain(tree.tests.iter().cloned()).collect();
    let there: BTreeSet<_> = ["src", "core/src"].into_iter().flat_map(files).collect();
    assert_eq!(read, there);
}

#[test]
fn files_are_small() {
    let lines = |file: PathBuf| (fs::read_to_string(root().join(&file)).unwrap().lines().count(), file);
    let mut lengths: Vec<_> = FOLDERS.into_iter().flat_map(files).map(lines).collect();
    lengths.sort();
    let (longest, file) = lengths.last().unwrap();
    assert!(*longest <= MAX_LINES, "{} has {longest} lines", file.display());
    let (median, _) = lengths[lengths.len() / 2];
    assert!(median <= MAX_MEDIAN_LINES, "half of the files have {median} lines or more");
}

/// The files of Rust in a folder and its subfolders.
fn files(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(root().join(folder)).unwrap() {
        let path = Path::new(folder).join(entry.unwrap().file_name());
        if root().join(&path).is_dir() {
            found.extend(files(path.to_str().unwrap()));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.push(path);
        }
    }
    found
}
