use posed::evaluation::Targets;
use serde_json::json;

use crate::folder::Folder;

#[test]
fn targets_say_what_counts() {
    let folder = Folder::new();
    let list = json!([
        {"im_id": 3, "inst_count": 1, "obj_id": 1, "scene_id": 2},
        {"im_id": 3, "inst_count": 2, "obj_id": 5, "scene_id": 2},
        {"im_id": 9, "scene_id": 2},
    ]);
    let path = folder.put("test_targets_bop19.json", &list.to_string());
    let targets = Targets::read(&path).unwrap();
    let counts = [(2, 3, 1), (2, 3, 5), (2, 3, 6), (2, 4, 1), (1, 3, 1)].map(|(s, i, o)| targets.instances(s, i, o));
    assert_eq!(counts, [1, 2, 0, 0, 0]);
    assert!(targets.instances(2, 9, 6) > 1000);
    assert_eq!(targets.images(5).collect::<Vec<_>>(), [(2, 3), (2, 9)]);
    for wrong in ["[", "[]", r#"[{"im_id": 3}]"#] {
        let path = folder.put("targets.json", wrong);
        let said = Targets::read(&path).unwrap_err().to_string();
        assert!(said.contains("targets.json"), "{said}");
    }
}
