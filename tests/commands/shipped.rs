//! What ships keeps what it promises, on twelve views of four objects that no network has learned from.

use serde_json::Value;

use crate::support::run;

const EVALUATE: [&str; 11] = [
    "evaluate",
    "cube",
    "bracket",
    "motor",
    "link",
    "--split",
    "tests/data/film",
    "--meshes",
    "training/demo/models",
    "--visible",
    "0..1",
];

/// Neither too small, which a robot pays for, nor so large that they say nothing.
#[test]
fn covariances_are_as_large_as_the_errors() {
    let report = report();
    let all = report["sections"].as_array().unwrap().iter().find(|section| section["object"] == "(all)");
    let all = all.unwrap_or_else(|| panic!("no section of all objects: {}", report["sections"]));
    for part in ["depth", "lateral", "rotation"] {
        let errors_in_sigmas = all["consistency"][part]["sigma_ratio"].as_f64().unwrap();
        assert!((0.6..1.6).contains(&errors_in_sigmas), "{part}: {errors_in_sigmas}");
    }
}

/// `ok` is for robots: likely right, and not so rare that nobody can use it.
#[test]
fn ok_is_a_high_probability_and_right() {
    let report = report();
    let views = report["views"].as_array().unwrap();
    let ok: Vec<&Value> = views.iter().filter(|view| view["status"] == "ok").collect();
    assert!(3 * ok.len() > views.len(), "{} of {}", ok.len(), views.len());
    for view in &ok {
        assert!(view["right"] == true && view["confidence"].as_f64().unwrap() > 0.9, "{view}");
    }
}

fn report() -> Value {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("report.json");
    let output = run(&[&EVALUATE[..], &["--json", file.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
}
