use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use serde::Deserialize;
use thiserror::Error;

use crate::model::{ManifestError, read_json};
use posed_core::geometry::{BopSymmetries, METRES_PER_MILLIMETRE, Symmetries, SymmetryError};

/// A BOP models folder that cannot be read.
#[derive(Debug, Error)]
pub enum MeshError {
    #[error(transparent)]
    Info(#[from] ManifestError),
    #[error("{}: object {obj_id}: {source}", path.display())]
    Symmetries { path: PathBuf, obj_id: u32, source: SymmetryError },
    #[error("{}: no object {obj_id}", path.display())]
    NoObject { path: PathBuf, obj_id: u32 },
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: no vertices with coordinates x, y, z", path.display())]
    NoVertices { path: PathBuf },
}

/// What scoring needs of an object: its vertices (metres, frame `object`), size and symmetry.
#[derive(Clone, Debug)]
pub struct ObjectMesh {
    pub vertices: Vec<Vector3<f64>>,
    pub diameter_m: f64,
    /// Under which motions the object looks the same: where there are any, ADD-S applies.
    pub symmetries: Symmetries,
}

#[derive(Deserialize)]
struct Info {
    diameter: f64,
    #[serde(flatten)]
    symmetries: BopSymmetries,
}

impl ObjectMesh {
    /// Reads `models_info.json` and `obj_NNNNNN.ply` of a BOP models folder.
    ///
    /// # Errors
    /// [`MeshError`] names the file.
    pub fn read(folder: &Path, obj_id: u32) -> Result<Self, MeshError> {
        let path = folder.join("models_info.json");
        let mut objects: BTreeMap<u32, Info> = read_json(&path)?;
        let info = objects.remove(&obj_id).ok_or_else(|| MeshError::NoObject { path: path.clone(), obj_id })?;
        let symmetries =
            Symmetries::try_from(&info.symmetries).map_err(|source| MeshError::Symmetries { path, obj_id, source })?;
        let vertices = read_vertices(&folder.join(format!("obj_{obj_id:06}.ply")))?;
        Ok(Self { vertices, diameter_m: info.diameter * METRES_PER_MILLIMETRE, symmetries })
    }
}

fn read_vertices(path: &Path) -> Result<Vec<Vector3<f64>>, MeshError> {
    let unreadable = |source| MeshError::Read { path: path.into(), source };
    let mut reader = BufReader::new(File::open(path).map_err(unreadable)?);
    let ply = Parser::<DefaultElement>::new()
        .read_ply(&mut reader)
        .map_err(|error| unreadable(std::io::Error::other(error)))?;
    let coordinate = |vertex: &DefaultElement, axis: &str| match vertex.get(axis) {
        Some(Property::Float(value)) => Some(f64::from(*value)),
        Some(Property::Double(value)) => Some(*value),
        _ => None,
    };
    let vertices: Option<Vec<_>> = ply.payload.get("vertex").and_then(|vertices| {
        vertices
            .iter()
            .map(|v| Some(Vector3::new(coordinate(v, "x")?, coordinate(v, "y")?, coordinate(v, "z")?)))
            .collect()
    });
    vertices
        .filter(|vertices| !vertices.is_empty())
        .map(|vertices| vertices.into_iter().map(|v| v * METRES_PER_MILLIMETRE).collect())
        .ok_or_else(|| MeshError::NoVertices { path: path.into() })
}
