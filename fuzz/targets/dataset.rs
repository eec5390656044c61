//! Scenes of the BOP format and of LINEMOD, lists of targets and results: files in one input, separated by `\n---\n`.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use posed::evaluation::{ObjectMesh, ReadOptions, SceneFolder, Targets, read_poses};

const FILES: [&str; 7] = [
    "scene_camera.json",
    "scene_gt.json",
    "scene_gt_info.json",
    "gt.yml",
    "info.yml",
    "models_info.json",
    "list",
];

fuzz_target!(|bytes: &[u8]| {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut rest = bytes;
    for name in FILES {
        let end = rest.windows(5).position(|five| five == b"\n---\n");
        let (text, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + 5..]));
        if !text.is_empty() {
            std::fs::write(folder.path().join(name), text).expect("a temporary file");
        }
        rest = after;
    }
    read(folder.path());
});

fn read(folder: &Path) {
    let options = ReadOptions::default();
    if let Ok(scene) = SceneFolder::at(folder, &options).and_then(|scene| scene.read(&options)) {
        for id in 0..4 {
            if let Ok(view) = scene.view(id) {
                let _ = (view.truths(1), view.truths(2));
            }
        }
    }
    let _ = ObjectMesh::read(folder, 1);
    let _ = Targets::read(&folder.join("list"));
    let _ = read_poses(&folder.join("list"));
}
