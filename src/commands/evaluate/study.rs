//! Accuracy against the number of reference images: the plot of the paper over pose labels.

use std::fmt::Write as _;

use fastrand::Rng;
use posed_core::calibration::{Mode, Offset};
use posed_core::pnp::Solution;
use serde::Serialize;

use super::plan::Task;
use crate::estimator::{KeypointSolver, LocatedView, average_offsets, fit_offset_and_scale, measure_offset};
use crate::evaluation::{Deviation, ModelPoints, Recall, ReferencesCurve, ScoredView, Spread, references_plot};
use crate::model::ObjectModel;
use crate::vision::{DecodeOptions, read_image};

/// So many references are drawn ...
const COUNTS: [usize; 3] = [1, 3, 10];
/// ... so many times.
const DRAWS: usize = 10;
/// Fewer say nothing of the scale.
const MIN_TO_FIT_SCALE: usize = 3;

/// What is made of the references that are drawn.
#[derive(Clone, Copy)]
struct Making {
    word: &'static str,
    mode: Mode,
    /// Whether the keypoints' scale follows from the same references.
    fit_scale: bool,
}

const MAKINGS: [Making; 3] = [
    Making { word: "weighted", mode: Mode::Weighted, fit_scale: false },
    Making { word: "paper", mode: Mode::Paper, fit_scale: false },
    Making { word: "weighted, scale", mode: Mode::Weighted, fit_scale: true },
];

/// An object in an image, and where its keypoints are found.
pub(super) struct SolvedView {
    pub(super) object: usize,
    located: LocatedView,
    image_width_px: u32,
    /// `None` where there is no pose.
    solution: Option<Solution>,
}

impl SolvedView {
    fn offset(&self, keypoints_scale: f64) -> Option<Offset> {
        measure_offset(&self.located.camera_from_object, self.solution.as_ref()?, keypoints_scale).ok()
    }
}

/// Accuracy with some number of references.
#[derive(Debug, Serialize)]
pub(super) struct StudyRow {
    pub(super) object: String,
    /// `weighted`, `paper`, or `weighted, scale` where the keypoints' scale was fitted, too.
    pub(super) mode: &'static str,
    pub(super) references: usize,
    pub(super) draws: usize,
    /// Draws whose references contradict each other: they have no accuracy, and count as 0.
    pub(super) contradictory: usize,
    pub(super) add: Spread,
    pub(super) deg5_cm5: Spread,
    pub(super) median_rotation_deg: Spread,
    pub(super) median_translation_m: Spread,
}

/// Solves the keypoints of all instances of an image, within their true boxes.
///
/// # Errors
/// In words that name the image.
pub(super) fn solve(solvers: &mut [KeypointSolver<'_>], task: &Task) -> Result<Vec<SolvedView>, String> {
    let wrong = |error: &dyn std::fmt::Display| format!("{}: {error}", task.image.display());
    let image = read_image(&task.image, &DecodeOptions::default()).map_err(|error| wrong(&error))?;
    let mut solved = Vec::new();
    for instance in task.instances.iter().filter(|instance| instance.counts) {
        let solver = &mut solvers[instance.object];
        let (prediction, solution) =
            solver.solve(&image, &instance.region, &task.camera).map_err(|error| wrong(&error))?;
        solved.push(SolvedView {
            object: instance.object,
            located: LocatedView {
                camera: task.camera.clone(),
                camera_from_object: instance.truth.camera_from_object,
                prediction,
            },
            image_width_px: image.width(),
            solution: solution.ok(),
        });
    }
    Ok(solved)
}

/// The rows of one object, from its views as references and its views to be scored.
///
/// # Errors
/// When no view can be a reference.
pub(super) fn study(
    model: &ObjectModel,
    points: &ModelPoints,
    candidates: &[&SolvedView],
    views: &[&SolvedView],
) -> Result<Vec<StudyRow>, String> {
    let references: Vec<&SolvedView> = candidates.iter().copied().filter(|view| view.offset(1.0).is_some()).collect();
    let name = &model.manifest.name;
    if references.is_empty() {
        return Err(format!("none of the {} views of {name} can be a reference", candidates.len()));
    }
    let mut rows = Vec::new();
    for making in MAKINGS {
        let counts = COUNTS.into_iter().filter(|count| *count < references.len());
        let all = (references.len(), 1);
        for (count, draws) in counts.map(|count| (count, DRAWS)).chain([all]) {
            if making.fit_scale && count < MIN_TO_FIT_SCALE {
                continue;
            }
            // The same draws for all that is made of them.
            let mut random = Rng::with_seed(count as u64);
            let scores: Vec<Option<Recall>> = (0..draws)
                .map(|_| {
                    let drawn = random.choose_multiple(references.iter().copied(), count);
                    score(points, &make(model, &drawn, making)?, views)
                })
                .collect();
            rows.push(StudyRow {
                object: name.clone(),
                mode: making.word,
                references: count,
                draws,
                contradictory: scores.iter().filter(|score| score.is_none()).count(),
                add: spread(&scores, 0.0, |score| score.add),
                deg5_cm5: spread(&scores, 0.0, |score| score.within(5, 5).unwrap_or(0.0)),
                median_rotation_deg: spread(&scores, 180.0, |score| score.median_rotation_deg),
                median_translation_m: spread(&scores, f64::INFINITY, |score| score.median_translation_m),
            });
        }
    }
    Ok(rows)
}

/// Where the references say nothing of the scale, it stays. `None` where they contradict each other.
fn make(model: &ObjectModel, references: &[&SolvedView], making: Making) -> Option<Offset> {
    let of_scale = |keypoints_scale| {
        let offsets = references.iter().filter_map(|view| view.offset(keypoints_scale)).collect();
        average_offsets(model, offsets, making.mode).ok()
    };
    let averaged = of_scale(1.0)?;
    let located: Vec<&LocatedView> = references.iter().map(|view| &view.located).collect();
    let fit = || fit_offset_and_scale(model, &located, &averaged, of_scale);
    let fitted = making.fit_scale.then(fit).flatten();
    Some(fitted.map_or(averaged.offset, |(averaged, _)| averaged.offset))
}

fn score(points: &ModelPoints, offset: &Offset, views: &[&SolvedView]) -> Option<Recall> {
    let scored = |view: &&SolvedView| {
        let LocatedView { camera, camera_from_object, .. } = &view.located;
        let estimate = view
            .solution
            .as_ref()
            .map(|solution| offset.apply(&solution.pose.scaled(offset.keypoints_scale), &solution.covariance).0);
        let deviation = |estimate| Deviation::new(points, camera, &estimate, camera_from_object);
        ScoredView {
            deviation: estimate.map(deviation),
            diameter_m: points.diameter_m(),
            image_width_px: view.image_width_px,
        }
    };
    Recall::of(&views.iter().map(scored).collect::<Vec<_>>())
}

/// Over all draws.
fn spread(scores: &[Option<Recall>], contradictory: f64, value: impl Fn(&Recall) -> f64) -> Spread {
    let values: Vec<f64> = scores.iter().map(|score| score.as_ref().map_or(contradictory, &value)).collect();
    Spread {
        mean: values.iter().sum::<f64>() / values.len().max(1) as f64,
        least: values.iter().copied().fold(f64::INFINITY, f64::min),
        most: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    }
}

/// The rows as a Markdown table.
pub(super) fn table(rows: &[StudyRow]) -> String {
    let mut text = String::from(
        "| object | references | mode | draws | ADD(-S) %, mean (least to most) | 5°5cm %, mean (least to most) | rotation, median \
         (deg) | translation, median (mm) |\n|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let share = |spread: &Spread| {
            format!("{:.1} ({:.1} to {:.1})", 1e2 * spread.mean, 1e2 * spread.least, 1e2 * spread.most)
        };
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {:.2} | {:.1} |",
            row.object,
            row.references,
            row.mode,
            if row.contradictory == 0 {
                row.draws.to_string()
            } else {
                format!("{} ({} contradict)", row.draws, row.contradictory)
            },
            share(&row.add),
            share(&row.deg5_cm5),
            row.median_rotation_deg.mean,
            1e3 * row.median_translation_m.mean,
        );
    }
    text
}

/// The rows as a plot, an SVG file.
pub(super) fn plot(rows: &[StudyRow]) -> String {
    let curve = |of: &[&StudyRow]| {
        let name = |row: &StudyRow| if row.draws == 1 { "all".into() } else { row.references.to_string() };
        ReferencesCurve {
            object: of[0].object.clone(),
            references: of.iter().map(|row| name(row)).collect(),
            points: of.iter().map(|row| row.add).collect(),
        }
    };
    let of_mode = |mode: &str| {
        let rows: Vec<&StudyRow> = rows.iter().filter(|row| row.mode == mode).collect();
        let curves = rows.chunk_by(|a, b| a.object == b.object).map(curve).collect();
        (format!("{mode} average"), curves)
    };
    references_plot(&["weighted", "paper"].map(of_mode))
}
