use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use thiserror::Error;

use super::dataset::DatasetError;
use super::models_info::ModelsInfo;
use super::ply;
use posed_core::geometry::{METRES_PER_MILLIMETRE, Symmetries, SymmetryError};

/// Folders of meshes within that of a dataset: those made for scores first.
const WITHIN_DATASET: [&str; 2] = ["models_eval", "models"];
/// Diagonal of the box about a mesh, of its diameter: between 1 and the square root of 3, and a little for simplified meshes.
const DIAGONAL: RangeInclusive<f64> = 0.8..=2.0;

/// A folder of meshes that cannot be read.
#[derive(Debug, Error)]
pub enum MeshError {
    #[error(transparent)]
    Info(#[from] DatasetError),
    #[error("{}: object {obj_id}: {source}", path.display())]
    Symmetries { path: PathBuf, obj_id: u32, source: SymmetryError },
    #[error("{}: no object {obj_id}; there are {known}", path.display())]
    NoObject { path: PathBuf, obj_id: u32, known: String },
    #[error("{}: object {obj_id}: field '{field}' {reason}", path.display())]
    Field { path: PathBuf, obj_id: u32, field: &'static str, reason: String },
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: no vertices with finite coordinates x, y, z", path.display())]
    NoVertices { path: PathBuf },
    #[error(
        "{}: the diagonal of the box about the vertices is {extent_mm} mm, but the object's diameter is said to be \
         {diameter_mm} mm: one of the two is wrong, or in another unit",
        path.display()
    )]
    Scale { path: PathBuf, extent_mm: f64, diameter_mm: f64 },
}

/// What scoring needs of an object: its vertices (metres, frame `object`), size and symmetry.
#[derive(Clone, Debug)]
pub struct ObjectMesh {
    pub vertices: Vec<Vector3<f64>>,
    pub diameter_m: f64,
    /// Under which motions the object looks the same: where there are any, ADD-S applies.
    pub symmetries: Symmetries,
}

impl ObjectMesh {
    /// Reads one object of a folder of meshes, or of a dataset that has one: `models_info.json` and `obj_NNNNNN.ply` of the BOP
    /// format, or `models_info.yml` and `obj_NN.ply` of LINEMOD.
    ///
    /// # Errors
    /// [`MeshError`] names the file, the object and the field.
    pub fn read(folder: &Path, obj_id: u32) -> Result<Self, MeshError> {
        let within = WITHIN_DATASET.map(|name| folder.join(name));
        let folder = if ModelsInfo::is_in(folder) {
            folder
        } else {
            within.iter().find(|folder| ModelsInfo::is_in(folder)).map_or(folder, PathBuf::as_path)
        };
        let info = ModelsInfo::read(folder)?;
        let path = info.path.clone();
        let wrong = |reason| MeshError::Field { path: path.clone(), obj_id, field: "diameter", reason };
        let known = || info.objects.keys().map(u32::to_string).collect::<Vec<_>>().join(", ");
        let object = info.objects.get(&obj_id);
        let object = object.ok_or_else(|| MeshError::NoObject { path: path.clone(), obj_id, known: known() })?;
        let object = object.as_ref().map_err(|reason| DatasetError::Syntax {
            path: path.clone(),
            reason: format!("object {obj_id}: {reason}"),
        })?;
        let diameter_mm = object.diameter.ok_or_else(|| wrong("is missing".into()))?;
        if !(diameter_mm.is_finite() && diameter_mm > 0.0) {
            return Err(wrong(format!("is {diameter_mm}; it must be a positive number of millimetres")));
        }
        let symmetries = Symmetries::try_from(&object.symmetries()).map_err(|source| MeshError::Symmetries {
            path: path.clone(),
            obj_id,
            source,
        })?;
        let names = [format!("obj_{obj_id:06}.ply"), format!("obj_{obj_id:02}.ply")].map(|name| folder.join(name));
        let path = names.iter().find(|path| path.is_file()).unwrap_or(&names[0]);
        let vertices_mm = ply::vertices(path).map_err(|source| MeshError::Read { path: path.clone(), source })?;
        let extent_mm = extent(&vertices_mm).ok_or_else(|| MeshError::NoVertices { path: path.clone() })?;
        if !DIAGONAL.contains(&(extent_mm / diameter_mm)) {
            return Err(MeshError::Scale { path: path.clone(), extent_mm, diameter_mm });
        }
        Ok(Self {
            vertices: vertices_mm.into_iter().map(|v| v * METRES_PER_MILLIMETRE).collect(),
            diameter_m: diameter_mm * METRES_PER_MILLIMETRE,
            symmetries,
        })
    }
}

/// Diagonal of the box around points; `None` if there are none, or they are nowhere.
fn extent(points: &[Vector3<f64>]) -> Option<f64> {
    let (first, rest) = points.split_first()?;
    let (least, most) = rest.iter().fold((*first, *first), |(least, most), point| (least.inf(point), most.sup(point)));
    let finite = points.iter().all(|point| point.iter().all(|value| value.is_finite()));
    finite.then(|| (most - least).norm())
}
