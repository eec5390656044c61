//! The report as Markdown tables, for terminals and documents.

use std::fmt::Write as _;

use crate::evaluation::{Boxes, Detections, GroupConsistency, Interval, Report, Section};

/// All tables, those of each split below its name.
pub(super) fn tables(report: &Report) -> String {
    let mut text = String::new();
    for sections in report.sections.chunk_by(|a, b| a.split == b.split) {
        let split = &sections[0].split;
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{split}\n\n{}", accuracy(sections));
        // Files of results state no trust.
        if report.boxes != Boxes::File {
            let _ = writeln!(text, "{}", trust(sections));
        }
        let detections: Vec<_> = report.detection.iter().filter(|one| one.split == *split).collect();
        if !detections.is_empty() {
            let _ = writeln!(text, "{}", detection(&detections));
        }
    }
    text
}

fn accuracy(sections: &[Section]) -> String {
    let mut text = String::from(
        "| object | visible | views | ADD(-S) % | Proj-5 % | 5°5cm % | AR (no VSD) % | rotation, median (deg) | \
         translation, median (mm) |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for section in sections {
        let (recall, intervals) = (&section.recall, &section.intervals);
        let Section { object, visible, .. } = section;
        let views = recall.views;
        let _ = writeln!(
            text,
            "| {object} | {visible} | {views} | {} | {} | {} | {} | {:.2} | {:.1} |",
            percent(recall.add, intervals.add),
            percent(recall.proj5, intervals.proj5),
            percent(recall.within(5, 5).unwrap_or(0.0), intervals.deg5_cm5),
            percent(recall.ar_without_vsd, intervals.ar_without_vsd),
            recall.median_rotation_deg,
            1e3 * recall.median_translation_m,
        );
    }
    text
}

fn trust(sections: &[Section]) -> String {
    let mut text = String::from(
        "| object | visible | ok | ok but wrong % | right but not ok | no answer | NEES mean, median (honest) | in \
         95 % | depth, lateral, rotation (sigmas) | Brier | ECE |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for section in sections {
        let Section { object, visible, verdicts, intervals, .. } = section;
        let wrong = verdicts.ok_wrong_share().map_or("-".into(), |share| percent(share, intervals.ok_wrong));
        let consistency = section.consistency.as_ref();
        let pose = consistency.and_then(|consistency| consistency.pose.as_ref());
        let nees =
            pose.map_or("-".into(), |pose| format!("{:.1}, {:.1} ({:.0})", pose.mean, pose.median, pose.mean_degrees));
        let within_95 = pose.and_then(GroupConsistency::within_95);
        let covered = within_95.map_or("-".into(), |share| format!("{:.1} %", 1e2 * share));
        let ratios =
            consistency.and_then(|all| Some([all.depth.as_ref()?, all.lateral.as_ref()?, all.rotation.as_ref()?]));
        let sigmas =
            ratios.map_or("-".into(), |groups| groups.map(|group| format!("{:.1}", group.sigma_ratio)).join(", "));
        let trust = section.trust.as_ref();
        let [brier, ece] = [trust.map(|trust| trust.brier), trust.map(|trust| trust.ece)]
            .map(|figure| figure.map_or("-".into(), |figure| format!("{figure:.3}")));
        let _ = writeln!(
            text,
            "| {object} | {visible} | {} | {wrong} | {} | {} | {nees} | {covered} | {sigmas} | {brier} | {ece} |",
            verdicts.ok, verdicts.not_ok_right, verdicts.unanswered,
        );
    }
    text
}

fn detection(detections: &[&Detections]) -> String {
    let mut text = String::from(
        "| object | images | boxes to find | recall % | precision % | false boxes per image | of these ok |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for Detections { object, score, false_ok, .. } in detections {
        let share = |share: Option<f64>| share.map_or("-".into(), |share| format!("{:.1}", 1e2 * share));
        let _ = writeln!(
            text,
            "| {object} | {} | {} | {} | {} | {:.3} | {false_ok} |",
            score.images,
            score.true_positives + score.misses,
            share(score.recall),
            share(score.precision),
            score.false_boxes_per_image.unwrap_or(0.0),
        );
    }
    text
}

/// A share with its interval, in percent.
fn percent(share: f64, interval: Option<Interval>) -> String {
    let share = format!("{:.1}", 1e2 * share);
    interval.map_or(share.clone(), |Interval { low, high }| format!("{share} ({:.0} to {:.0})", 1e2 * low, 1e2 * high))
}
