//! Bundles that cannot be served.

use std::path::Path;

use reqwest::StatusCode;
use serde_json::{Value, json as value};

use crate::bundle::{Bundle, Entry, move_keypoints, tar};
use crate::objects::{Folders, files, get, has, put};
use crate::onnx::{Element, Graph, Tensor};
use crate::support::{CAMERA, assert_still_works, error, json, post, read, samples};

/// A manifest with one value changed.
fn stated(bundle: &Bundle, change: impl FnOnce(&mut Value)) -> Value {
    let mut manifest = bundle.manifest();
    change(&mut manifest);
    manifest
}

/// Each is refused with what is wrong with it; nothing changes, and nothing is left behind.
#[tokio::test]
#[allow(clippy::too_many_lines, reason = "one story")]
async fn a_bundle_that_cannot_be_served_changes_nothing() {
    let folders = Folders::without_cube();
    let server = folders.serve(&["--object-changes"]);
    let (before, listed) = (files(folders.models.path()), get(&server, "/v1/objects").await);
    let good = Bundle::of("cube");
    let with = |name: &str, bytes: &[u8]| {
        let mut bundle = good.clone();
        bundle.add(name, bytes.into());
        bundle.tar()
    };
    let with_json = |name: &str, change: &dyn Fn(&mut Value)| {
        let mut bundle = good.clone();
        bundle.change(name, change);
        bundle
    };
    let manifest = |change: &dyn Fn(&mut Value)| good.tar_with(&stated(&good, change), &[]);
    let more = |entry: Entry| good.tar_with(&good.manifest(), &[entry]);
    let whole = good.tar();
    let mut damaged = whole.clone();
    let at = damaged.windows(9).position(|window| window == b"For tests").unwrap();
    damaged[at] = b'f';
    let mut goes_on = whole.clone();
    goes_on.extend_from_slice(b"more");
    // A net that is one, and answers something else than a keypoint net does.
    let other_net = Graph::default()
        .input("image", Element::Uint8, &[1, 8, 8, 3])
        .answer(Tensor::floats("peaks", &[1, 8], &[0.9; 8]))
        .file();
    let with_net = |net: &[u8]| {
        let mut bundle = good.clone().without(&["parity", "reference"]);
        bundle.change("object.json", |json| json["model_sha256"] = crate::bundle::sha256(net).into());
        bundle.add("keypoints.onnx", net.into());
        bundle.tar()
    };
    let without = |names: &[&str]| good.clone().without(names).tar();
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        ("nothing", Vec::new(), "first file of the bundle"),
        ("no tar", vec![7; 5000], "no tar file"),
        ("no manifest", tar(&[Entry::file("object.json", b"{}")]), "first file of the bundle is \"object.json\""),
        ("no JSON", tar(&[Entry::file("bundle.json", b"{")]), "bundle.json: "),
        ("format", manifest(&|json| json["format"] = "zip".into()), "'format' is not \"posed-bundle\""),
        ("older", manifest(&|json| json["version"] = 0.into()), "'version' is 0, which is older than 1"),
        ("newer", manifest(&|json| json["version"] = 2.into()), "'version' is 2, which is newer than 1"),
        ("unknown field", manifest(&|json| json["colour"] = 1.into()), "colour"),
        (
            "other name",
            manifest(&|json| json["name"] = "teapot".into()),
            "of object \"teapot\", but the path says \"cube\"",
        ),
        ("bad name", manifest(&|json| json["name"] = "../x".into()), "'name' contains \"../x\""),
        ("detector", manifest(&|json| json["name"] = "detector".into()), "the folder of the shared detector"),
        ("bomb", manifest(&|json| json["files"]["keypoints.onnx"]["bytes"] = (1_u64 << 40).into()), "at most"),
        ("large JSON", manifest(&|json| json["files"]["object.json"]["bytes"] = (5 << 20).into()), "at most 4194304"),
        (
            "other size",
            manifest(&|json| json["files"]["NOTICE"]["bytes"] = 3.into()),
            "has 10 bytes, but bundle.json states 3",
        ),
        ("other hash", manifest(&|json| json["files"]["NOTICE"]["sha256"] = "0".into()), "it is damaged"),
        ("damaged", damaged, "\"NOTICE\", which has sha256"),
        ("parent", with("../escape", b"x"), "no file of a bundle"),
        ("absolute", with("/tmp/escape", b"x"), "no file of a bundle"),
        ("other file", with("run.sh", b"x"), "no file of a bundle"),
        ("hidden image", with("reference/.x.jpg", b"x"), "no file of a bundle"),
        ("deep image", with("reference/a/b.jpg", b"x"), "no file of a bundle"),
        ("unlisted parent", more(Entry::file("../escape", b"x")), "\"../escape\", which is not in bundle.json"),
        (
            "link",
            more(Entry::link("keypoints.onnx", tar::EntryType::Symlink, "/etc/passwd")),
            "no regular file (Symlink)",
        ),
        ("hard link", more(Entry::link("report.html", tar::EntryType::Link, "NOTICE")), "no regular file (Link)"),
        ("device", more(Entry::link("report.html", tar::EntryType::Block, "")), "no regular file (Block)"),
        ("long name", more(Entry::link("x", tar::EntryType::GNULongName, "")), "no regular file"),
        ("twice", more(Entry::file("NOTICE", b"For tests.")), "is there twice"),
        ("short", whole[..whole.len() / 2].to_vec(), ""),
        (
            "cut before the end",
            tar(&[Entry::file("bundle.json", good.manifest().to_string().as_bytes())]),
            "ends without",
        ),
        ("goes on", goes_on, "goes on after its end"),
        ("no net", without(&["keypoints.onnx"]), "does not have \"keypoints.onnx\""),
        ("lone parity", without(&["parity.png"]), "they come together"),
        ("lone images", without(&["reference.json"]), "no \"reference.json\""),
        (
            "other object",
            with_json("object.json", &|json| json["name"] = "teapot".into()).tar(),
            "for object \"teapot\"",
        ),
        (
            "bad field",
            with_json("object.json", &|json| json["diameter_m"] = 77.into()).tar(),
            "object.json: field 'diameter_m' is 77",
        ),
        ("other net", with("keypoints.onnx", b"no net"), "keypoints.onnx has sha256"),
        ("no ONNX", with_net(b"no net"), "ONNX"),
        ("no keypoints", with_net(&other_net), "keypoints"),
        ("parity", with_json("parity.json", &move_keypoints).tar(), "something else here"),
        (
            "many crops",
            with_json("parity.json", &|json| json["keypoints_px"] = value!(vec![[[0, 0]]; 65])).tar(),
            "65 crops",
        ),
        (
            "stale reference",
            with_json("reference.json", &|json| json["keypoint_model_sha256"] = "0".repeat(64).into()).tar(),
            "another keypoint net",
        ),
        (
            "label",
            with_json("detector/detector.json", &|json| json["labels"] = value!(["cup", null, null, null])).tar(),
            "do not have \"cube\"",
        ),
        ("detector", with("detector/detector.onnx", b"no net"), "detector.onnx has sha256"),
    ];
    for (name, bundle, words) in cases {
        let response = put(&server, "cube", bundle).await;
        let status = response.status();
        let (code, message) = error(response).await;
        assert_eq!((status, code.as_str()), (StatusCode::UNPROCESSABLE_ENTITY, "invalid_bundle"), "{name}: {message}");
        assert!(message.contains(words) && !message.contains("incoming"), "{name}: {message}");
        assert_eq!(files(folders.models.path()), before, "{name}");
    }
    assert_eq!(get(&server, "/v1/objects").await, listed);
    assert!(!Path::new("/tmp/escape").exists());
    let image = read(&samples()[0].file);
    assert!(has(&json(post(&server, CAMERA, image).await).await, "motor"));
    assert_eq!(put(&server, "cube", whole).await.status(), StatusCode::OK);
    assert_still_works(&server).await;

    // Nor is the old one lost to one that fails.
    let old = get(&server, "/v1/objects/cube").await;
    assert_eq!(put(&server, "cube", with_net(b"no net")).await.status(), StatusCode::UNPROCESSABLE_ENTITY);
    assert_eq!(get(&server, "/v1/objects/cube").await, old);
    assert_still_works(&server).await;
}
