//! `posed objects`.

use std::path::Path;

use serde_json::Value;

use crate::bundle::{Bundle, move_keypoints};
use crate::support::{assert_right, change, copy_of, explanation, run, samples};

fn objects(folder: &Path, arguments: &[&str]) -> std::process::Output {
    let models = folder.to_str().unwrap();
    run(&[&["objects"], arguments, &["--models", models]].concat())
}

fn said(output: &std::process::Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// From an empty folder: a bundle, a folder, a list, and away again.
#[test]
fn objects_are_added_listed_and_removed() {
    let (models, scratch) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let file = scratch.path().join("cube.posed");
    std::fs::write(&file, Bundle::of("cube").tar()).unwrap();
    assert!(said(&objects(models.path(), &["add", file.to_str().unwrap()])).contains("cube was added"));
    let folder = scratch.path().join("motor");
    Bundle::of("motor").without(&["detector", "reference"]).write(&folder);
    let empty = scratch.path().join("reference");
    let without = ["add", folder.to_str().unwrap(), "--reference", empty.to_str().unwrap()];
    let told = said(&objects(models.path(), &without));
    assert!(
        told.contains("motor was added") && told.contains("posed calibrate motor") && told.contains("'boxes'"),
        "{told}"
    );
    assert!(said(&objects(models.path(), &["add", file.to_str().unwrap()])).contains("cube was replaced"));

    let list = said(&objects(models.path(), &["list", "--reference", empty.to_str().unwrap()]));
    let line = |name: &str| {
        let line = list.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().skip(1).take(2).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!((line("cube"), line("motor")), (vec!["yes".into(), "own".into()], vec!["no".into(), "none".into()]));
    let sample = &samples()[0];
    let image = sample.file.to_str().unwrap();
    let estimate = ["estimate", image, "--camera", "samples/demo.camera.json", "--json", "--models"];
    let places = [models.path().to_str().unwrap(), "--reference", empty.to_str().unwrap()];
    let answer: Value = serde_json::from_slice(&run(&[&estimate[..], &places].concat()).stdout).unwrap();
    let found: Vec<_> =
        answer["poses"].as_array().unwrap().iter().map(|pose| pose["object"].as_str().unwrap()).collect();
    assert_eq!(found, ["cube"]);

    assert!(said(&objects(models.path(), &["remove", "cube", "motor"])).contains("motor was removed"));
    assert_eq!(std::fs::read_dir(models.path()).unwrap().count(), 0);
    for name in ["cube", "../cube", "", "."] {
        assert!(explanation(&objects(models.path(), &["remove", name])).contains("there is no object"), "{name:?}");
    }
}

#[test]
fn what_cannot_be_served_is_not_added() {
    let models = copy_of("models");
    let scratch = tempfile::tempdir().unwrap();
    let before = std::fs::read(models.path().join("cube/object.json")).unwrap();
    let folder = scratch.path().join("cube");
    Bundle::of("cube").write(&folder);
    change(&folder.join("parity.json"), move_keypoints);
    let damaged = scratch.path().join("cube.posed");
    let mut bytes = Bundle::of("cube").tar();
    bytes.truncate(bytes.len() / 2);
    std::fs::write(&damaged, bytes).unwrap();
    let nothing = scratch.path().to_str().unwrap();
    for (source, words) in [
        (folder.to_str().unwrap(), "something else here"),
        (damaged.to_str().unwrap(), "cube.posed: "),
        (nothing, "no object.json"),
        ("nowhere.posed", "nowhere.posed: "),
        ("README.md", "no tar file"),
    ] {
        let message = explanation(&objects(models.path(), &["add", source]));
        assert!(message.contains(words) && message.contains("nothing has changed"), "{source}: {message}");
        assert_eq!(std::fs::read(models.path().join("cube/object.json")).unwrap(), before);
        assert_eq!(std::fs::read_dir(models.path()).unwrap().count(), 5, "{source}");
    }
    assert_right(&samples()[0], &{
        let image = samples()[0].file.to_str().unwrap().to_owned();
        let places = ["--json", "--models", models.path().to_str().unwrap()];
        let output = run(&[&["estimate", &image, "--camera", "samples/demo.camera.json"], &places[..]].concat());
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    });
}
