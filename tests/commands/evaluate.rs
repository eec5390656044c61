//! `posed evaluate` on splits with faults.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::{Value, json};

use crate::SCENE;
use crate::support::{copy_of, explanation, run};

/// A split of one scene, number 5, with the same image several times.
fn split(images: usize) -> tempfile::TempDir {
    let split = tempfile::tempdir().unwrap();
    let scene = split.path().join("000005");
    fs::rename(copy_of(SCENE).keep(), &scene).unwrap();
    for name in ["scene_gt.json", "scene_gt_info.json", "scene_camera.json"] {
        edit(&scene.join(name), |all| {
            for id in 1..images {
                all[id.to_string()] = all["0"].clone();
            }
        });
    }
    for id in 1..images {
        fs::copy(scene.join("rgb/000000.jpg"), scene.join(format!("rgb/{id:06}.jpg"))).unwrap();
    }
    split
}

fn edit(path: &Path, change: impl FnOnce(&mut Value)) {
    let mut value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    change(&mut value);
    fs::write(path, value.to_string()).unwrap();
}

fn evaluate(split: &Path, extra: &[&str]) -> Output {
    let common = ["evaluate", "cube", "--split", split.to_str().unwrap(), "--meshes", "training/demo/models"];
    run(&[&common[..], extra].concat())
}

/// The cells of the first row of the first table: accuracy. Object, visible, views, ADD(-S) and so on.
fn row(output: &Output) -> Vec<String> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines().nth(4).unwrap().split('|').skip(1).map(|cell| cell.trim().to_owned()).collect()
}

/// All figures of an evaluation.
fn figures(split: &Path, extra: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("figures.json");
    let output = evaluate(split, &[&["--json", path.to_str().unwrap()], extra].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn several_jobs_score_as_one_does() {
    let split = split(5);
    let [one, three] = ["1", "3"].map(|jobs| row(&evaluate(split.path(), &["--jobs", jobs, "--threads", "1"])));
    assert_eq!((one[2].as_str(), &one), ("5", &three));
}

#[test]
fn what_cannot_be_scored_is_listed_or_left_out() {
    let split = split(4);
    let scene = split.path().join("000005");
    fs::remove_file(scene.join("rgb/000001.jpg")).unwrap();
    edit(&scene.join("scene_gt_info.json"), |all| drop(all["2"].as_array_mut().unwrap().pop()));
    // No fault of the cube's.
    edit(&scene.join("scene_gt.json"), |all| all["0"][1]["cam_R_m2c"] = json!([2, 0, 0, 0, 2, 0, 0, 0, 2]));
    let said = explanation(&evaluate(split.path(), &[]));
    for words in ["2 problems", "--keep-going", "image 1: ", "image 2: 3 objects, but 4"] {
        assert!(said.contains(words), "{said}");
    }
    let output = evaluate(split.path(), &["--keep-going"]);
    assert_eq!(row(&output)[2], "2");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("skipped because of 2 problems"), "{said}");
    // Pixels are found to be damaged only when they are read.
    fs::write(scene.join("rgb/000003.jpg"), "no image").unwrap();
    assert!(explanation(&evaluate(split.path(), &[])).contains("2 problems"));
    let output = evaluate(split.path(), &["--keep-going"]);
    assert_eq!(row(&output)[2], "1");
    assert!(String::from_utf8_lossy(&output.stderr).contains("rgb/000003.jpg"));
}

#[test]
fn damaged_pixels_are_an_error() {
    let split = split(1);
    fs::write(split.path().join("000005/rgb/000000.jpg"), "no image").unwrap();
    let said = explanation(&evaluate(split.path(), &[]));
    assert!(said.contains("rgb/000000.jpg") && said.contains("--keep-going"), "{said}");
    let said = explanation(&evaluate(split.path(), &["--keep-going"]));
    assert!(said.contains("rgb/000000.jpg") && said.contains("no view of cube"), "{said}");
}

#[test]
fn lists_of_different_length_are_an_error() {
    let split = split(1);
    edit(&split.path().join("000005/scene_gt_info.json"), |all| all["0"] = json!([]));
    let said = explanation(&evaluate(split.path(), &[]));
    assert!(said.contains("scene_gt_info.json: image 0: 0 objects, but 4 in scene_gt.json"), "{said}");
}

#[test]
fn an_object_that_is_not_seen_is_no_view_of_it() {
    let split = split(2);
    edit(&split.path().join("000005/scene_gt_info.json"), |all| all["1"][0]["bbox_visib"] = json!([-1, -1, -1, -1]));
    let output = evaluate(split.path(), &["--visible", "0..1"]);
    assert_eq!(row(&output)[2], "1");
    assert!(String::from_utf8_lossy(&output.stderr).contains("not visible: 1"));
}

#[test]
fn only_targets_are_scored() {
    let split = split(3);
    let targets = split.path().join("test_targets_bop19.json");
    let put = |list: Value| fs::write(&targets, list.to_string()).unwrap();
    let extra = ["--targets", targets.to_str().unwrap()];
    put(
        json!([{"scene_id": 5, "im_id": 2, "obj_id": 1, "inst_count": 1}, {"scene_id": 5, "im_id": 0, "obj_id": 2, "inst_count": 1}]),
    );
    assert_eq!(row(&evaluate(split.path(), &extra))[2], "1");
    put(
        json!([{"scene_id": 5, "im_id": 2, "obj_id": 1, "inst_count": 1}, {"scene_id": 5, "im_id": 77, "obj_id": 1, "inst_count": 1}]),
    );
    let said = explanation(&evaluate(split.path(), &extra));
    assert!(said.contains("scene 5") && said.contains("image 77"), "{said}");
}

/// Ground truth in the form of a file of results, moved by so many millimetres along x.
fn truth_as_results(split: &Path, shift_mm: f64) -> String {
    let scene = split.join("000005");
    let truths: Value = serde_json::from_slice(&fs::read(scene.join("scene_gt.json")).unwrap()).unwrap();
    let mut lines = "scene_id,im_id,obj_id,score,R,t,time\n".to_owned();
    for (image, objects) in truths.as_object().unwrap() {
        for object in objects.as_array().unwrap() {
            let numbers = |field: &str| -> Vec<f64> { serde_json::from_value(object[field].clone()).unwrap() };
            let words = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
            let mut translation = numbers("cam_t_m2c");
            translation[0] += shift_mm;
            let (rotation, translation) = (words(&numbers("cam_R_m2c")), words(&translation));
            writeln!(lines, "5,{image},{},1.0,{rotation},{translation},0.1", object["obj_id"]).unwrap();
        }
    }
    lines
}

#[test]
fn truth_as_the_estimate_scores_full_marks_and_an_error_is_measured() {
    let split = split(3);
    let file = split.path().join("truth_set-test.csv");
    let score = |shift_mm: f64| {
        fs::write(&file, truth_as_results(split.path(), shift_mm)).unwrap();
        let common = ["evaluate", "cube", "bracket", "motor", "link", "--split", split.path().to_str().unwrap()];
        let json = split.path().join("figures.json");
        let extra = ["--meshes", "training/demo/models", "--visible", "0..1", "--estimates", file.to_str().unwrap()];
        let output = run(&[&common[..], &extra, &["--json", json.to_str().unwrap()]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: Value = serde_json::from_slice(&fs::read(json).unwrap()).unwrap();
        report["sections"].as_array().unwrap().clone()
    };
    let sections = score(0.0);
    // Four objects, and all of them together.
    assert_eq!(sections.len(), 5);
    for section in sections {
        let recall = &section["recall"];
        for figure in ["add", "proj5", "ar_mssd", "ar_mspd", "ar_without_vsd"] {
            assert_eq!(recall[figure], 1.0, "{figure} of {section}");
        }
        assert!(recall["degrees_centimetres"].as_array().unwrap().iter().all(|one| one["share"] == 1.0));
        assert!(recall["median_add_m"].as_f64().unwrap() < 1e-9);
        assert_eq!(section["verdicts"]["ok_wrong"], 0);
        // Three views say no more than that.
        let low = section["intervals"]["add"]["low"].as_f64().unwrap();
        assert!(low > 0.4 && low < 0.9, "{low}");
    }
    for section in score(60.0) {
        let recall = &section["recall"];
        assert_eq!((&recall["add"], &section["verdicts"]["ok_wrong"]), (&json!(0.0), &recall["views"]), "{section}");
        assert!((recall["median_translation_m"].as_f64().unwrap() - 0.06).abs() < 1e-6);
    }
}

#[test]
fn what_is_written_for_the_toolkit_scores_as_what_was_estimated() {
    let split = split(2);
    let folder = tempfile::tempdir().unwrap();
    let estimated =
        figures(split.path(), &["--detector", "--bop", folder.path().to_str().unwrap(), "--method", "mine"]);
    let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    let file = names[0].to_str().unwrap();
    assert!(file.contains("/mine_") && names[0].extension().unwrap() == "csv", "{file}");
    let read = figures(split.path(), &["--estimates", file]);
    let [read, estimated_recall] = [&read, &estimated].map(|report| &report["sections"][0]["recall"]);
    for figure in ["views", "add", "proj5", "ar_mssd", "ar_mspd", "degrees_centimetres"] {
        assert_eq!(read[figure], estimated_recall[figure], "{figure}");
    }
    let median = |recall: &Value| recall["median_add_m"].as_f64().unwrap();
    assert!((median(read) - median(estimated_recall)).abs() < 1e-9);
    let boxes: Value = serde_json::from_slice(&fs::read(&names[1]).unwrap()).unwrap();
    let cube = boxes.as_array().unwrap().iter().find(|one| one["category_id"] == 1).unwrap();
    assert_eq!((&cube["scene_id"], cube["bbox"].as_array().unwrap().len()), (&json!(5), 4));
    assert_eq!(estimated["detection"][0]["recall"], 1.0);
}

#[test]
fn a_report_holds_all_that_it_shows() {
    let split = split(1);
    let path = split.path().join("report.html");
    let output = evaluate(split.path(), &["--html", path.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = fs::read_to_string(&path).unwrap();
    assert!(page.matches("<svg").count() >= 4 && page.contains("data:image/jpeg;base64,"));
    // Nothing is loaded from elsewhere; names of XML formats are no addresses to load.
    let addresses = page.replace("http://www.w3.org/", "");
    assert!(!addresses.contains("http") && !page.contains("<script") && !page.contains("<link"));
}

#[test]
fn each_range_of_visibility_has_its_row() {
    let split = split(3);
    for (image, fraction) in [("1", 0.5), ("2", 0.1)] {
        edit(&split.path().join("000005/scene_gt_info.json"), |all| {
            all[image].as_array_mut().unwrap().iter_mut().for_each(|object| object["visib_fract"] = json!(fraction));
        });
    }
    let report = figures(split.path(), &["--visible", "0.7..1", "--visible", "0.3..0.7"]);
    let rows: Vec<_> =
        report["sections"].as_array().unwrap().iter().map(|s| (&s["visible"], &s["recall"]["views"])).collect();
    assert_eq!(rows, [(&json!("0.7..1"), &json!(1)), (&json!("0.3..0.7"), &json!(1))]);
    let said = explanation(&evaluate(split.path(), &["--visible", "0.8..0.2"]));
    assert!(said.contains("--visible") && said.contains("LOW..HIGH"), "{said}");
}

#[test]
fn more_references_are_studied() {
    let split = split(4);
    let path = split.path().to_str().unwrap();
    let plot = split.path().join("references.svg");
    let output = evaluate(split.path(), &["--references-study", path, "--plot", plot.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let rows: Vec<Vec<_>> =
        text.lines().skip(2).map(|line| line.split('|').skip(1).take(4).map(str::trim).collect()).collect();
    // Four views: one and three of them are drawn, and all are taken once.
    let counts: Vec<_> = rows.iter().map(|row| (row[1], row[2], row[3])).collect();
    let of_mode = |mode| [("1", mode, "10"), ("3", mode, "10"), ("4", mode, "1")];
    // One image says nothing of the scale.
    let with_scale = of_mode("weighted, scale")[1..].to_vec();
    assert_eq!(counts, [of_mode("weighted").to_vec(), of_mode("paper").to_vec(), with_scale].concat());
    assert!(fs::read_to_string(plot).unwrap().starts_with("<svg"));
    // The references are the very views that are scored.
    assert!(text.lines().nth(2).unwrap().contains("100.0 (100.0 to 100.0)"), "{text}");
}

#[test]
fn of_several_results_the_surest_counts_whatever_its_line() {
    let split = split(1);
    let file = split.path().join("two_set-test.csv");
    let lines: Vec<String> = [0.0, 60.0].map(|shift_mm| truth_as_results(split.path(), shift_mm)).into();
    let body = |text: &str, score: &str| {
        let (_, body) = text.split_once('\n').unwrap();
        body.replace(",1.0,", &format!(",{score},"))
    };
    let header = lines[0].lines().next().unwrap();
    for (scores, expected) in [(["0.9", "0.1"], 1.0), (["0.1", "0.9"], 0.0)] {
        // The wrong pose stands first in the file.
        let text = format!("{header}\n{}{}", body(&lines[1], scores[1]), body(&lines[0], scores[0]));
        fs::write(&file, text).unwrap();
        let report = figures(split.path(), &["--estimates", file.to_str().unwrap()]);
        assert_eq!(report["sections"][0]["recall"]["add"], expected);
    }
}

#[test]
fn results_of_nothing_that_is_asked_for_are_an_error() {
    let split = split(1);
    let file = split.path().join("other_set-test.csv");
    let text = truth_as_results(split.path(), 0.0);
    for other in
        [text.replace("\n5,", "\n6,"), text.replace("\n5,0,", "\n5,9,"), text.lines().next().unwrap().to_owned()]
    {
        fs::write(&file, other).unwrap();
        let said = explanation(&evaluate(split.path(), &["--estimates", file.to_str().unwrap()]));
        assert!(said.contains("other_set-test.csv: none of its"), "{said}");
    }
}

#[test]
fn what_would_be_counted_or_written_twice_is_refused() {
    let split = split(1);
    let folder = split.path().to_str().unwrap();
    let out = split.path().join("out");
    let out = out.to_str().unwrap();
    for (extra, words) in [
        (vec!["--split", folder], "--split"),
        (vec!["cube"], "object cube is given twice"),
        (vec!["--visible", "0.5..1", "--visible", "0.5..1"], "--visible 0.5..1 is given twice"),
        (vec!["--json", out, "--html", out], "written twice"),
        (vec!["--json", folder], "it is a folder"),
        (vec!["--bop", folder, "--method", "../evil"], "--method"),
    ] {
        let said = explanation(&evaluate(split.path(), &extra));
        assert!(said.contains(words), "{said}");
    }
}

#[test]
fn objects_without_a_view_do_not_cost_the_others_their_figures() {
    let split = split(1);
    edit(&split.path().join("000005/scene_gt.json"), |all| {
        all["0"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .filter(|one| one["obj_id"] == 2)
            .for_each(|one| one["obj_id"] = json!(9));
    });
    let output = run(&[
        "evaluate",
        "cube",
        "bracket",
        "--split",
        split.path().to_str().unwrap(),
        "--meshes",
        "training/demo/models",
    ]);
    assert!(explanation(&output).contains("no view of bracket"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("| cube | 0.7..1 | 1 |"));
}

#[test]
fn each_view_is_in_the_figures_and_its_visibility_is_checked() {
    let split = split(2);
    let report = figures(split.path(), &[]);
    let views = report["views"].as_array().unwrap();
    assert_eq!((views.len(), &views[1]["image_id"], &views[1]["scene"]), (2, &json!(1), &json!("000005")));
    assert!(views[0]["deviation"]["add_m"].is_number() && views[0]["nees"]["pose"]["degrees"] == 6);
    edit(&split.path().join("000005/scene_gt_info.json"), |all| {
        all["1"].as_array_mut().unwrap().iter_mut().for_each(|object| object["visib_fract"] = json!(70));
    });
    let said = explanation(&evaluate(split.path(), &[]));
    assert!(said.contains("image 1") && said.contains("field 'visib_fract' is 70"), "{said}");
}
