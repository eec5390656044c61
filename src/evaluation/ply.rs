use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

use nalgebra::Vector3;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{PropertyAccess, PropertyAccessResult};

/// Of an element, all that matters here: datasets state coordinates in any type of number, and colours, normals and faces beside.
#[derive(Default)]
struct Vertex {
    coordinates: [Option<f64>; 3],
}

impl Vertex {
    fn set(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        let Some(axis) = ["x", "y", "z"].iter().position(|axis| *axis == name) else {
            return PropertyAccessResult::Ignored;
        };
        self.coordinates[axis] = Some(value);
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_char(&mut self, name: &str, value: i8) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_uchar(&mut self, name: &str, value: u8) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_short(&mut self, name: &str, value: i16) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_ushort(&mut self, name: &str, value: u16) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_int(&mut self, name: &str, value: i32) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_uint(&mut self, name: &str, value: u32) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set(name, value.into())
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set(name, value)
    }
}

/// The vertices of a PLY file, text or binary, in its unit. Empty if one of them lacks a coordinate.
pub(super) fn vertices(path: &Path) -> io::Result<Vec<Vector3<f64>>> {
    let mut reader = BufReader::new(File::open(path)?);
    let mut ply = Parser::<Vertex>::new().read_ply(&mut reader).map_err(io::Error::other)?;
    let point = |vertex: Vertex| {
        let [x, y, z] = vertex.coordinates;
        Some(Vector3::new(x?, y?, z?))
    };
    let vertices = ply.payload.swap_remove("vertex").unwrap_or_default();
    Ok(vertices.into_iter().map(point).collect::<Option<_>>().unwrap_or_default())
}
