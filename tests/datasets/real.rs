use std::path::Path;

use posed::evaluation::ObjectMesh;
use posed::evaluation::ReadOptions;

use crate::folder::read_with;

/// The scene that the other tests calibrate and score on: all its objects have a box where their meshes are seen.
#[test]
fn the_shipped_scene_is_read() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let scene = read_with(&root.join("tests/data/scene"), &ReadOptions::default()).unwrap();
    assert_eq!(scene.image_ids().collect::<Vec<_>>(), [0]);
    let view = scene.view(0).unwrap();
    assert_eq!(view.objects.iter().map(|object| object.obj_id).collect::<Vec<_>>(), [1, 2, 3, 4]);
    for object in &view.objects {
        let truth = object.truth.clone().unwrap();
        let region = truth.bounding_box.unwrap();
        let mesh = ObjectMesh::read(&root.join("training/demo/models"), truth.obj_id).unwrap();
        for vertex in &mesh.vertices {
            let pixel = view.camera.project(&truth.camera_from_object.transform(vertex)).unwrap();
            let (right, down) = (pixel.x - region.x, pixel.y - region.y);
            assert!((-3.0..region.width + 3.0).contains(&right) && (-3.0..region.height + 3.0).contains(&down));
        }
    }
}
