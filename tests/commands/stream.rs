//! `posed evaluate --stream` on twelve images of a camera on its way.

use serde_json::Value;

use crate::support::{explanation, read, run};

const FILM: [&str; 5] = ["evaluate", "cube", "--split", "tests/data/film", "--stream"];
const MESHES: [&str; 2] = ["--meshes", "training/demo/models"];

#[test]
fn a_film_is_replayed_in_its_order() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("stream.json");
    let more = ["--fps", "10", "--detect-every", "5", "--json", json.to_str().unwrap()];
    let output = run(&[&FILM[..], &MESHES, &more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.lines().any(|line| line.starts_with("| 000001 | cube | 12 | 100.0 | 0 | ")), "{table}");
    let scenes: Value = serde_json::from_slice(&read(&json)).unwrap();
    let scene = &scenes[0];
    assert_eq!((&scene["images"], &scene["astray"]), (&12.into(), &0.into()));
    assert!((1..=4).contains(&scene["detected"].as_u64().unwrap()), "{scene}");
    let score = &scene["objects"][0][1];
    // A track of so few images still rests on the first ones, whatever the later ones say.
    for said in ["tracks", "single"] {
        assert!(score[said]["right"].as_f64().unwrap() > 0.5, "{score}");
        assert!(score[said]["translation_m"].as_f64().unwrap() < 0.012, "{score}");
    }
}

#[test]
fn what_makes_no_stream_is_refused() {
    for (more, words) in [
        (&["--fps", "0"][..], "must be a number from 0.01 to 1000"),
        (&["--detect-every", "0"], "1..=1000"),
        (&["--detector"], "cannot be used with"),
        (&["--without-truth"], "cannot be used with"),
        (&["--visible", "0..0.01"], "no view of the objects can be scored"),
    ] {
        let said = explanation(&run(&[&FILM[..], &MESHES, more].concat()));
        assert!(said.contains(words), "{said}");
    }
}
