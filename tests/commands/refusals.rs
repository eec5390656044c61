//! What `posed serve` refuses to start with.

use std::fs;
use std::net::TcpListener;
use std::process::Stdio;

use serde_json::Value;
use sha2::{Digest as _, Sha256};

use crate::onnx::{Attribute, Graph, Node, Tensor};
use crate::support::{FREE_PORTS, change, copy_of, explanation, posed, refuses_to_serve, root, run};

#[test]
fn damaged_models_are_named() {
    let damage = |file: &str, change: &dyn Fn(&mut Vec<u8>), words: &str| {
        let models = copy_of("models");
        let path = models.path().join(file);
        let mut bytes = fs::read(&path).unwrap();
        change(&mut bytes);
        fs::write(&path, bytes).unwrap();
        refuses_to_serve(&["--models", models.path().to_str().unwrap()], words);
    };
    damage("cube/keypoints.onnx", &|bytes| bytes[1000] ^= 0xFF, "sha256");
    damage("detector/detector.onnx", &|bytes| bytes.truncate(5000), "sha256");
    damage("cube/object.json", &|bytes| bytes.truncate(60), "cube/object.json");
    let replace = |from: &'static str, to: &'static str| {
        move |bytes: &mut Vec<u8>| *bytes = String::from_utf8_lossy(bytes).replace(from, to).into_bytes()
    };
    damage("cube/object.json", &replace("\"crop_scale\": 1.5", "\"crop_scale\": 1e9"), "'crop_scale'");
    damage("cube/object.json", &replace("\"name\": \"cube\"", "\"name\": \"../cube\""), "'name'");
    damage("cube/object.json", &replace("\"obj_id\"", "\"id\""), "`id`");
    let sheared = "\"symmetries_discrete\": [[1,1,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]], \"crop_scale\"";
    damage("cube/object.json", &replace("\"crop_scale\"", sheared), "'symmetries_discrete'");
    damage("detector/detector.json", &replace("end2end", "yolov99"), "yolov99");
    // Formats cannot be told apart by the file: the warm-up finds a wrong one before anybody waits.
    damage("detector/detector.json", &replace("end2end", "yolov8"), "has shape");
    damage("cube/object.json", &replace("\"kind\": \"keypoints\"", "\"kind\": \"heatmaps\""), "has shape");
}

/// As in `posed check | head -1`.
#[test]
fn a_reader_that_leaves_ends_a_command_quietly() {
    for arguments in [&["objects", "list"][..], &["serve", "--print-config"], &["completions", "bash"]] {
        let mut child = posed(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{arguments:?}: {output:?}");
    }
}

/// A pipe that nobody writes to would be waited for.
#[test]
fn only_regular_files_are_read() {
    let (models, reference) = (copy_of("models"), copy_of("reference"));
    let folders = [("--models", models.path()), ("--reference", reference.path())];
    for (flag, file) in [
        ("--reference", "cube.json"),
        ("--models", "cube/keypoints.onnx"),
        ("--models", "cube/object.json"),
        ("--models", "detector/detector.json"),
    ] {
        let folder = folders.iter().find(|(name, _)| *name == flag).unwrap().1;
        let path = folder.join(file);
        let kept = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let words = format!("{}: it is not a regular file", path.display());
        refuses_to_serve(&[flag, folder.to_str().unwrap()], &words);
        fs::remove_file(&path).unwrap();
        fs::write(&path, kept).unwrap();
    }
}

#[test]
fn a_file_that_is_no_network_is_named() {
    let models = copy_of("models");
    let network = models.path().join("cube/keypoints.onnx");
    fs::write(&network, b"this is not a network").unwrap();
    let manifest = models.path().join("cube/object.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&manifest).unwrap()).unwrap();
    // sha256 of the text above, so that the check of the hash passes.
    json["model_sha256"] = "c7b0c3ac7fbf1d2cc8ba2e4cd5d2d0ff6ef3a8b2b8f2f8f3c9a8e3a4d5b6c7d8".into();
    fs::write(&manifest, json.to_string()).unwrap();
    let folder = models.path().to_str().unwrap();
    let said = explanation(&run(&[&["serve"], &FREE_PORTS[..], &["--models", folder]].concat()));
    let found = said.split("has sha256 ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap().to_owned();
    json["model_sha256"] = found.into();
    fs::write(&manifest, json.to_string()).unwrap();
    let none = tempfile::tempdir().unwrap();
    refuses_to_serve(&["--models", folder, "--reference", none.path().to_str().unwrap()], "cannot load this network");
}

#[test]
fn missing_models_are_named() {
    refuses_to_serve(&["--models", "nowhere"], "cannot read the models folder nowhere");
    let models = copy_of("models");
    fs::remove_file(models.path().join("cube/keypoints.onnx")).unwrap();
    refuses_to_serve(&["--models", models.path().to_str().unwrap()], "cube/keypoints.onnx");
}

/// The server goes on without the object (`server/models.rs`); a command that was given it does not.
#[test]
fn a_reference_for_another_model_is_refused() {
    let reference = copy_of("reference");
    change(&reference.path().join("cube.json"), |json| json["keypoint_model_sha256"] = "0".repeat(64).into());
    let folder = reference.path().to_str().unwrap();
    let image = ["estimate", "samples/sample-1.jpg", "--camera", "samples/demo.camera.json", "--reference", folder];
    let said = explanation(&run(&image));
    assert!(said.contains("posed calibrate cube"), "{said}");
}

#[test]
fn a_reference_under_another_name_is_refused() {
    let reference = copy_of("reference");
    fs::copy(reference.path().join("cube.json"), reference.path().join("link.json")).unwrap();
    let folder = reference.path().to_str().unwrap();
    refuses_to_serve(&["--reference", folder], "is for object \"cube\", but its file is named after \"link\"");
}

/// Weights in another file are covered by no hash, and ONNX Runtime looks for them in the working folder.
#[test]
fn weights_in_other_files_are_refused() {
    let leak = || Tensor::elsewhere("leak", 100, "etc/passwd");
    assert!(fs::metadata("/etc/passwd").unwrap().len() > 100);
    let in_branch = Node::new("If", &["yes"], "leaked").with(Attribute::graph(
        "then_branch",
        Graph::default().node(Node::new("Constant", &[], "value").with(Attribute::tensor("value", leak()))),
    ));
    for addition in [
        Graph::default().constant(leak()),
        Graph::default().node(Node::new("Constant", &[], "leak").with(Attribute::tensor("value", leak()))),
        Graph::default().node(in_branch),
    ] {
        for (network, manifest) in
            [("cube/keypoints.onnx", "cube/object.json"), ("detector/detector.onnx", "detector/detector.json")]
        {
            let models = copy_of("models");
            let path = models.path().join(network);
            let bytes = [fs::read(&path).unwrap(), addition.clone().addition()].concat();
            fs::write(&path, &bytes).unwrap();
            let hash = Sha256::digest(&bytes).iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"));
            change(&models.path().join(manifest), |json| json["model_sha256"] = hash.into());
            let none = tempfile::tempdir().unwrap();
            let folders = [models.path().to_str().unwrap(), none.path().to_str().unwrap()];
            let output = posed(&["serve", "--models", folders[0], "--reference", folders[1]])
                .args(FREE_PORTS)
                .env("ORT_DYLIB_PATH", root().join(".onnxruntime/libonnxruntime.so"))
                .current_dir("/")
                .output()
                .unwrap();
            let said = explanation(&output);
            assert!(said.contains("\"etc/passwd\"") && said.contains("embed the weights"), "{said}");
        }
    }
}

#[test]
fn a_port_in_use_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for flag in ["--http", "--grpc", "--admin"] {
        let ports: Vec<&str> = ["--http", "--grpc", "--admin"]
            .into_iter()
            .flat_map(|port| [port, if port == flag { &address } else { "127.0.0.1:0" }])
            .collect();
        let said = explanation(&run(&[&["serve"], &ports[..]].concat()));
        assert!(said.contains(&address) && said.contains(flag), "{said}");
    }
}

#[test]
fn a_missing_runtime_is_explained() {
    let output =
        posed(&["serve"]).args(FREE_PORTS).env("ORT_DYLIB_PATH", "/nowhere/libonnxruntime.so").output().unwrap();
    let said = explanation(&output);
    assert!(said.contains("/nowhere/libonnxruntime.so") && said.contains("make onnxruntime"), "{said}");
    let wrong = root().join("Cargo.toml");
    let output = posed(&["serve"]).args(FREE_PORTS).env("ORT_DYLIB_PATH", wrong).output().unwrap();
    assert!(explanation(&output).contains("not a usable ONNX Runtime library"));
}

/// `auto` takes what is there; what is stated must be there.
#[test]
fn openvino_is_looked_for_beside_the_runtime() {
    let folder = tempfile::tempdir().unwrap();
    let library = folder.path().join("libonnxruntime.so");
    std::os::unix::fs::symlink(root().join(".onnxruntime/libonnxruntime.so"), &library).unwrap();
    let check =
        |provider: &str| posed(&["check", "--provider", provider]).env("ORT_DYLIB_PATH", &library).output().unwrap();
    let said = explanation(&check("openvino"));
    assert!(said.contains("OpenVINO") || said.contains("libonnxruntime_providers_openvino.so is missing"), "{said}");
    assert!(said.contains("--provider cpu"), "{said}");
    let output = check("auto");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8(output.stdout).unwrap().starts_with("provider cpu\n"));
}
