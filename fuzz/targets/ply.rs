//! Meshes as PLY files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use posed::evaluation::ObjectMesh;

fuzz_target!(|bytes: &[u8]| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let info = r#"{"1": {"diameter": 100.0}}"#;
    std::fs::write(folder.path().join("models_info.json"), info).expect("a temporary file");
    std::fs::write(folder.path().join("obj_000001.ply"), bytes).expect("a temporary file");
    let _ = ObjectMesh::read(folder.path(), 1);
});
