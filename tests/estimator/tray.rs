//! More objects in one image than an answer holds.

use std::sync::Arc;

use posed::estimator::{Estimate, Frame, MAX_DETECTIONS, Selection};
use posed::model::Input;
use serde_json::json;

use crate::script::{Manifests, Models, Script, camera, image, output};

/// Scores and classes of boxes that do not overlap, the first at the top left.
fn seeing(boxes: &[(f32, f32)]) -> Script {
    let box_at = |(index, (score, class)): (usize, &(f32, f32))| {
        let (x, y) = ((index % 12) as f32 * 26.0, (index / 12) as f32 * 26.0);
        [x, y, x + 24.0, y + 24.0, *score, *class]
    };
    let rows: Vec<f32> = boxes.iter().enumerate().flat_map(box_at).collect();
    let detector = Arc::new(move |_: Input<'_>| Ok(vec![output("detections", &[1, rows.len() / 6, 6], rows.clone())]));
    Script { detector, ..Script::default() }
}

fn estimate(detector: &serde_json::Value, boxes: &[(f32, f32)], selection: &Selection) -> Estimate {
    let mut manifests = Manifests::default();
    manifests.detector["labels"] = json!(["block", "other"]);
    for (field, value) in detector.as_object().unwrap() {
        manifests.detector[field] = value.clone();
    }
    let (image, camera) = (image(50), camera());
    let frame = Frame { selection, ..Frame::new(&image, &camera) };
    Models::new(&manifests, seeing(boxes)).estimator().unwrap().estimate_all(&[frame]).remove(0).unwrap()
}

const BLOCK: (f32, f32) = (0.8, 0.0);
/// Of another class, which the detector is surer of.
const OTHER: (f32, f32) = (0.9, 1.0);

#[test]
fn a_full_tray_is_cut_and_the_answer_says_so() {
    let full = |count: usize| estimate(&json!({}), &vec![BLOCK; count], &Selection::ALL);
    let (all, cut) = (full(MAX_DETECTIONS), full(MAX_DETECTIONS + 1));
    assert_eq!((all.poses.len(), all.truncated), (MAX_DETECTIONS, false));
    assert_eq!((cut.poses.len(), cut.truncated), (MAX_DETECTIONS, true));
}

#[test]
fn what_is_not_asked_for_takes_no_room() {
    let mut boxes = vec![OTHER; 2 * MAX_DETECTIONS];
    boxes.extend([BLOCK; 3]);
    let selection = Selection { objects: Some(vec!["block".into()]), ..Selection::ALL };
    for selection in [&selection, &Selection::ALL] {
        let answer = estimate(&json!({}), &boxes, selection);
        assert_eq!((answer.poses.len(), answer.truncated), (3, false));
    }
    // Weak boxes neither: no pose is trusted more than its box.
    let mut boxes = vec![(0.6, 0.0); 2 * MAX_DETECTIONS];
    boxes.extend([BLOCK; 3]);
    let sure = Selection { min_confidence: 0.7, ..Selection::ALL };
    let answer = estimate(&json!({}), &boxes, &sure);
    assert_eq!((answer.poses.len(), answer.truncated), (3, false));
    assert!(estimate(&json!({}), &boxes, &Selection::ALL).truncated);
}

/// An object that is taken for another is not found in its place only since nobody asked for the other.
#[test]
fn a_selection_does_not_bring_back_what_was_suppressed() {
    let rows = vec![20.0, 20.0, 80.0, 80.0, 0.9, 1.0, 20.0, 20.0, 80.0, 80.0, 0.6, 0.0];
    let detector = Arc::new(move |_: Input<'_>| Ok(vec![output("detections", &[1, 2, 6], rows.clone())]));
    let mut manifests = Manifests::default();
    manifests.detector["labels"] = json!(["block", "other"]);
    let mut estimator = Models::new(&manifests, Script { detector, ..Script::default() }).estimator().unwrap();
    assert!(estimator.estimate(&image(50), &camera()).unwrap().poses.is_empty());
}

/// The detector's own limits, where its manifest states them.
#[test]
fn a_detector_that_returns_no_more_boxes_is_told() {
    let weak = (0.3, 0.0);
    for (limits, boxes, truncated) in [
        (json!({"max_detections_per_class": 4}), vec![BLOCK; 4], true),
        (json!({"max_detections_per_class": 4}), vec![BLOCK; 3], false),
        // Below the threshold it returned some: it has left out none above.
        (json!({"max_detections_per_class": 4}), vec![BLOCK, BLOCK, weak, weak], false),
        (json!({"max_detections_per_class": 4}), vec![OTHER, OTHER, OTHER, OTHER, BLOCK], false),
        (json!({"max_detections": 4}), vec![OTHER, OTHER, OTHER, BLOCK], true),
        (json!({"max_detections": 5}), vec![OTHER, OTHER, OTHER, BLOCK], false),
        (json!({}), vec![BLOCK; 8], false),
    ] {
        let answer = estimate(&limits, &boxes, &Selection::ALL);
        assert_eq!(answer.truncated, truncated, "{limits} {boxes:?}");
    }
}
