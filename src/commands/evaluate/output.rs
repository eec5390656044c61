use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::options::{OutputArgs, first_twice};
use crate::evaluation::{BoxResult, PoseResult, results_name, write_boxes, write_poses};
use crate::model::write_atomically;

/// What the BOP toolkit reads of one split.
#[derive(Default)]
pub(super) struct Written {
    pub(super) poses: Vec<PoseResult>,
    pub(super) boxes: Vec<BoxResult>,
}

impl OutputArgs {
    /// Refuses places that cannot be written, before hours are spent.
    ///
    /// # Errors
    /// In words that name the file.
    pub(super) fn check(&self, splits: &[PathBuf]) -> Result<(), String> {
        let names: Vec<_> = splits.iter().map(|split| results_name(&self.method, split)).collect();
        if let Some(name) = first_twice(&names).filter(|_| self.bop.is_some()) {
            return Err(format!("--bop: several splits would be written to {name}.csv; evaluate them one by one"));
        }
        let paths: Vec<_> = [&self.json, &self.html, &self.plot].into_iter().flatten().collect();
        if let Some(twice) = first_twice(&paths) {
            return Err(format!("{} is to be written twice", twice.display()));
        }
        for path in paths {
            if path.is_dir() {
                return Err(format!("cannot write {}: it is a folder", path.display()));
            }
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
                return Err(format!("cannot write {}: there is no folder {}", path.display(), folder.display()));
            }
        }
        match &self.bop {
            Some(folder) => fs::create_dir_all(folder).map_err(|error| unwritten(folder, &error)),
            None => Ok(()),
        }
    }

    pub(super) fn write_json(&self, figures: &impl Serialize) -> Result<(), String> {
        let Some(path) = &self.json else { return Ok(()) };
        let bytes = serde_json::to_vec_pretty(figures).map_err(|error| unwritten(path, &error.into()))?;
        write(path, &bytes)
    }

    pub(super) fn write_html(&self, page: &str) -> Result<(), String> {
        write_text(self.html.as_deref(), page)
    }

    pub(super) fn write_plot(&self, svg: &str) -> Result<(), String> {
        write_text(self.plot.as_deref(), svg)
    }

    pub(super) fn write_bop(&self, split: &Path, written: &Written) -> Result<(), Box<dyn std::error::Error>> {
        let Some(folder) = &self.bop else { return Ok(()) };
        let name = results_name(&self.method, split);
        write_poses(&folder.join(format!("{name}.csv")), &written.poses)?;
        if !written.boxes.is_empty() {
            write_boxes(&folder.join(format!("{name}_boxes.json")), &written.boxes)?;
        }
        Ok(())
    }
}

fn unwritten(path: &Path, error: &std::io::Error) -> String {
    format!("cannot write {}: {error}", path.display())
}

fn write_text(path: Option<&Path>, text: &str) -> Result<(), String> {
    path.map_or(Ok(()), |path| write(path, text.as_bytes()))
}

/// Follows links; only regular files are replaced.
fn write(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let target = path.canonicalize().unwrap_or_else(|_| path.into());
    let replace = !target.exists() || target.is_file();
    let written = if replace { write_atomically(&target, bytes) } else { fs::write(&target, bytes) };
    written.map_err(|error| unwritten(path, &error))
}
