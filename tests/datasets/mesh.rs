use posed::evaluation::ObjectMesh;
use serde_json::{Value, json};

use crate::folder::Folder;

/// Three corners of a body of 60 mm, as text; the other properties say nothing here.
fn ascii(kind: &str) -> String {
    format!(
        "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 3\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n\
         property float nx\nproperty uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
         10 0 0 0.5 255\n-50 0 0 0.5 255\n0 20 -7 0.5 255\n3 0 1 2\n"
    )
}

fn binary(big: bool, kind: &str, bytes: impl Fn(i16) -> Vec<u8>) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let header = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex 3\nproperty uchar red\nproperty {kind} x\nproperty {kind} y\n\
         property {kind} z\nend_header\n"
    );
    let mut file = header.into_bytes();
    for point in [[10, 0, 0], [-50, 0, 0], [0, 20, -7]] {
        file.push(255);
        file.extend(point.into_iter().flat_map(&bytes));
    }
    file
}

fn models() -> Folder {
    let folder = Folder::new();
    folder.put("models_info.json", &json!({"3": {"diameter": 60.0}, "9": {"diameter": "large"}}).to_string());
    folder.put("obj_000003.ply", &ascii("float"));
    folder
}

fn assert_right(folder: &Folder, what: &str) {
    let mesh = ObjectMesh::read(folder.path(), 3).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert_eq!((mesh.vertices.len(), mesh.diameter_m), (3, 0.06));
    assert!((mesh.vertices[2] - nalgebra::Vector3::new(0.0, 0.02, -0.007)).norm() < 1e-9, "{what}");
}

#[test]
fn meshes_are_text_or_binary_of_any_number() {
    let folder = models();
    for kind in ["float", "double", "int", "short", "char"] {
        folder.put("obj_000003.ply", &ascii(kind));
        assert_right(&folder, kind);
    }
    let files = [
        binary(false, "float", |v| f32::from(v).to_le_bytes().to_vec()),
        binary(true, "double", |v| f64::from(v).to_be_bytes().to_vec()),
        binary(false, "int", |v| i32::from(v).to_le_bytes().to_vec()),
        binary(true, "short", |v| v.to_be_bytes().to_vec()),
    ];
    for file in &files {
        folder.put_bytes("obj_000003.ply", file);
        assert_right(&folder, "binary");
    }
    folder.put_bytes("obj_000003.ply", &files[0][..files[0].len() - 5]);
    let said = ObjectMesh::read(folder.path(), 3).unwrap_err().to_string();
    assert!(said.contains("obj_000003.ply"), "{said}");
}

#[test]
fn the_layouts_of_both_kinds_of_dataset_are_known() {
    for within in ["models", "models_eval"] {
        let dataset = Folder::new();
        dataset.put(&format!("{within}/models_info.json"), &json!({"3": {"diameter": 60.0}}).to_string());
        dataset.put(&format!("{within}/obj_000003.ply"), &ascii("float"));
        assert_right(&dataset, within);
    }
    let linemod = Folder::new();
    linemod.put("models/models_info.yml", "3: {diameter: 60.0, min_x: -50.0, size_x: 60.0}\n4: {diameter: 100.0}\n");
    linemod.put("models/obj_03.ply", &ascii("float"));
    assert_right(&linemod, "linemod");
}

#[test]
fn what_is_wrong_is_named() {
    let said = |change: &dyn Fn(&Folder)| {
        let folder = models();
        change(&folder);
        ObjectMesh::read(folder.path(), 3).unwrap_err().to_string()
    };
    let infos = |value: Value| move |folder: &Folder| drop(folder.put("models_info.json", &value.to_string()));
    let missing = said(&infos(json!({"1": {"diameter": 60.0}, "2": {"diameter": 50.0}})));
    assert!(missing.contains("models_info.json: no object 3; there are 1, 2"), "{missing}");
    let metres = said(&infos(json!({"1": {"diameter": 0.17}, "3": {"diameter": 0.06}})));
    assert!(
        metres.contains("models_info.json") && metres.contains("'diameter'") && metres.contains("metres"),
        "{metres}"
    );
    assert!(said(&infos(json!({"3": {"min_x": 1.0}}))).contains("object 3: field 'diameter' is missing"));
    assert!(said(&infos(json!({"3": {"diameter": "large"}}))).contains("object 3: invalid type"));
    let cut = said(&|folder| drop(folder.put("models_info.json", r#"{"3": {"diam"#)));
    assert!(cut.contains("models_info.json") && cut.contains("EOF"), "{cut}");
    let unit = said(&infos(json!({"1": {"diameter": 60.0}, "3": {"diameter": 60_000.0}})));
    assert!(unit.contains("obj_000003.ply") && unit.contains("another unit"), "{unit}");
    let flat = said(&|folder| drop(folder.put("obj_000003.ply", &ascii("float").replace("float z", "float depth"))));
    assert!(flat.contains("no vertices"), "{flat}");
    let gone = said(&|folder| std::fs::remove_file(folder.path().join("obj_000003.ply")).unwrap());
    assert!(gone.contains("obj_000003.ply"), "{gone}");
}

/// A half turn that was measured counts as one.
#[test]
fn symmetries_of_real_datasets_are_read() {
    let folder = models();
    let half_turn = [
        -0.999_964,
        -0.003_337_77,
        -0.007_745_2,
        0.232_611,
        0.003_214_62,
        -0.999_869,
        0.015_859_3,
        0.694_388,
        -0.007_797_12,
        0.015_833_8,
        0.999_844,
        -0.079_206_3,
        0.0,
        0.0,
        0.0,
        1.0,
    ];
    folder.put("models_info.json", &json!({"3": {"diameter": 60.0, "symmetries_discrete": [half_turn]}}).to_string());
    assert_eq!(ObjectMesh::read(folder.path(), 3).unwrap().symmetries.discrete().len(), 2);
    let axis = json!([{"axis": [0, 0, 1], "offset": [0, 0, 0]}]);
    folder.put("models_info.json", &json!({"3": {"diameter": 60.0, "symmetries_continuous": axis}}).to_string());
    assert_eq!(ObjectMesh::read(folder.path(), 3).unwrap().symmetries.continuous().len(), 1);
}
