//! Pictures for the report: images are read once more, those that are shown and no others.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::plan::Task;
use super::scoring::{ScoredSplit, Scoring};
use crate::evaluation::{ObjectRecords, Outline, Picture, Record, Sheet, close_up, picks};
use crate::vision::{DecodeOptions, read_image, status_colour};
use posed_core::geometry::Pose;

const TRUTH: [u8; 3] = [255; 3];

/// Contact sheets of each object in each split.
///
/// # Errors
/// When an image cannot be read any more.
pub(super) fn sheets(
    scoring: &Scoring<'_>,
    splits: &[ScoredSplit],
    all: &[ObjectRecords],
) -> Result<Vec<Sheet>, String> {
    let mut sheets = Vec::new();
    // `all` lists the objects of the first split, then those of the next.
    for (split, of_split) in splits.iter().zip(all.chunks(scoring.known.len())) {
        let named = |task: &'_ Task| (task.scene.clone(), task.image_id);
        let tasks: BTreeMap<_, _> = split.tasks.iter().map(|task| (named(task), task)).collect();
        for (of_object, known) in of_split.iter().zip(&scoring.known) {
            let records: Vec<&Record> = of_object.records.iter().collect();
            let is_right = |record: &Record| record.view(of_object.diameter_m).is_right();
            for group in picks(&records, is_right) {
                let mut pictures = Vec::new();
                for record in group.records {
                    let task = tasks.get(&(record.place.scene.clone(), record.place.image_id));
                    let Some(task) = task else { continue };
                    match picture(task, record, &known.corners, of_object) {
                        Ok(picture) => pictures.push(picture),
                        // It could be scored without its pixels.
                        Err(_) if scoring.keeps_going() => {}
                        Err(error) => return Err(error),
                    }
                }
                let (split, object) = (of_object.split.clone(), of_object.object.clone());
                sheets.push(Sheet { split, object, title: group.title, pictures });
            }
        }
    }
    Ok(sheets)
}

fn picture(
    task: &Task,
    record: &Record,
    corners: &[Vector3<f64>; 8],
    of_object: &ObjectRecords,
) -> Result<Picture, String> {
    let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", task.image.display());
    let image = read_image(&task.image, &DecodeOptions::default()).map_err(|error| wrong(&error))?;
    let corners = |pose: &Pose| corners.map(|corner| pose.transform(&corner));
    let truth = Outline { corners: corners(&record.camera_from_object), colour: TRUTH, axes: None };
    let answer = record.said.as_ref().map(|said| &said.answer);
    let estimate = answer.and_then(|answer| {
        let pose = answer.pose.as_ref()?;
        let axes = Some((*pose, 0.5 * of_object.diameter_m));
        Some(Outline { corners: corners(pose), colour: status_colour(answer.status), axes })
    });
    let outlines: Vec<_> = [truth].into_iter().chain(estimate).collect();
    let jpeg = close_up(&image, &task.camera, &record.region, &outlines).map_err(|error| wrong(&error))?;
    Ok(Picture { jpeg, captions: captions(record, of_object.diameter_m) })
}

fn captions(record: &Record, diameter_m: f64) -> Vec<String> {
    let place = &record.place;
    let mut lines = vec![format!("{}/{} #{}", place.scene, place.image_id, place.instance)];
    lines.push(format!("visible {:.0} %", 1e2 * record.visible_fraction));
    if let Some(said) = &record.said {
        let answer = &said.answer;
        let reasons =
            if answer.reasons.is_empty() { String::new() } else { format!(": {}", answer.reasons.join(", ")) };
        lines.push(format!("{}{reasons}; confidence {:.2}", answer.status, answer.confidence));
        if let Some(deviation) = &said.deviation {
            let share = 1e2 * deviation.add_m / diameter_m;
            lines.push(format!("ADD(-S) {:.1} mm, {share:.0} % of the diameter", 1e3 * deviation.add_m));
            lines.push(format!("{:.1}° and {:.1} mm off", deviation.rotation_deg, 1e3 * deviation.translation_m));
        }
    } else {
        lines.push("no answer".into());
    }
    lines
}
