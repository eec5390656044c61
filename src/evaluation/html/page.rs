use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::picture::{Picture, Sheet};
use super::plots;
use crate::evaluation::metrics::{GroupConsistency, Interval};
use crate::evaluation::report::{Boxes, Counted, Detections, ObjectRecords, Report, Section};

const STYLE: &str = include_str!("page.css");

/// The report as one HTML file. `objects` are those that it was made from.
#[must_use]
pub fn page(report: &Report, objects: &[ObjectRecords], sheets: &[Sheet]) -> String {
    let body = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "posed: accuracy" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "Accuracy of poses" }
                p.note { (introduction(report)) }
                @for of in objects.chunk_by(|a, b| a.split == b.split) { (one_split(report, of, sheets)) }
                (words())
            }
        }
    };
    body.into_string()
}

fn one_split(report: &Report, objects: &[ObjectRecords], sheets: &[Sheet]) -> Markup {
    let split = &objects[0].split;
    let sections: Vec<&Section> = report.sections.iter().filter(|section| section.split == *split).collect();
    let detections: Vec<&Detections> = report.detection.iter().filter(|one| one.split == *split).collect();
    html! {
        h2 { code { (split) } }
        (accuracy(&sections))
        @if report.boxes != Boxes::File { (trust(&sections)) }
        @if !detections.is_empty() { (detection(&detections)) }
        div.plots { (PreEscaped(plots::accuracy(objects))) }
        @for object in objects { (one_object(report, object, sheets)) }
    }
}

fn introduction(report: &Report) -> Markup {
    html! {
        "posed " (report.version) ". "
        @match report.boxes {
            Boxes::GroundTruth => "Each object was looked for in its true box.",
            Boxes::Detector => "Each object was looked for where the detector saw it. A view without an answer counts as wrong.",
            Boxes::File => "The poses come from a file of results.",
        }
        " Shares are followed by their 95 % interval (bootstrap over images)."
    }
}

fn accuracy(sections: &[&Section]) -> Markup {
    html! {
        h3 { "Accuracy" }
        table {
            tr {
                th { "object" } th { "visible" } th { "views" } th { "ADD(-S)" } th { "Proj-5" } th { "5°5cm" }
                th { "AR (no VSD)" } th { "rotation, median" } th { "translation, median" }
            }
            @for section in sections {
                @let (recall, intervals) = (&section.recall, &section.intervals);
                tr {
                    (named(section))
                    td.number { (recall.views) }
                    td.number { (percent(Some(recall.add), intervals.add)) }
                    td.number { (percent(Some(recall.proj5), intervals.proj5)) }
                    td.number { (percent(recall.within(5, 5), intervals.deg5_cm5)) }
                    td.number { (percent(Some(recall.ar_without_vsd), intervals.ar_without_vsd)) }
                    td.number { (format!("{:.2}°", recall.median_rotation_deg)) }
                    td.number { (format!("{:.1} mm", 1e3 * recall.median_translation_m)) }
                }
            }
        }
    }
}

fn trust(sections: &[&Section]) -> Markup {
    let group =
        |group: Option<&GroupConsistency>| group.map_or("–".into(), |group| format!("{:.1}", group.sigma_ratio));
    html! {
        h3 { "Trust" }
        table {
            tr {
                th { "object" } th { "visible" } th { "ok" } th { "ok, but wrong" } th { "right, but not ok" }
                th { "no answer" } th { "NEES, median" } th { "within 95 %" } th { "depth" } th { "lateral" } th { "rotation" }
                th { "Brier" } th { "ECE" }
            }
            @for section in sections {
                @let verdicts = &section.verdicts;
                @let consistency = section.consistency.as_ref();
                @let pose = consistency.and_then(|all| all.pose.as_ref());
                tr {
                    (named(section))
                    td.number { (verdicts.ok) }
                    td.number.bad[verdicts.ok_wrong > 0] {
                        (verdicts.ok_wrong)
                        @if let Some(share) = verdicts.ok_wrong_share() {
                            ", " (percent(Some(share), section.intervals.ok_wrong))
                        }
                    }
                    td.number { (verdicts.not_ok_right) }
                    td.number { (verdicts.unanswered) }
                    td.number { (pose.map_or("–".into(), |pose| format!("{:.1} of {:.0}", pose.median, pose.mean_degrees))) }
                    td.number { (percent(pose.and_then(GroupConsistency::within_95), None)) }
                    td.number { (group(consistency.and_then(|all| all.depth.as_ref()))) }
                    td.number { (group(consistency.and_then(|all| all.lateral.as_ref()))) }
                    td.number { (group(consistency.and_then(|all| all.rotation.as_ref()))) }
                    td.number { (figure(section.trust.as_ref().map(|trust| trust.brier))) }
                    td.number { (figure(section.trust.as_ref().map(|trust| trust.ece))) }
                }
            }
        }
        p.note { "Depth, lateral, rotation: errors of ok poses in units of their stated sigma. 1 is honest, more is too confident." }
    }
}

fn detection(detections: &[&Detections]) -> Markup {
    html! {
        h3 { "Detection" }
        table {
            tr {
                th { "object" } th { "images" } th { "boxes to find" } th { "recall" } th { "precision" }
                th { "false boxes per image" } th { "of these ok" }
            }
            @for one in detections {
                tr {
                    td { (one.object) }
                    td.number { (one.score.images) }
                    td.number { (one.score.true_positives + one.score.misses) }
                    td.number { (percent(one.score.recall, None)) }
                    td.number { (percent(one.score.precision, None)) }
                    td.number { (figure(one.score.false_boxes_per_image)) }
                    td.number.bad[one.false_ok > 0] { (one.false_ok) }
                }
            }
        }
    }
}

fn one_object(report: &Report, of: &ObjectRecords, sheets: &[Sheet]) -> Markup {
    let here = |split: &str, object: &str| split == of.split && object == of.object;
    let sections: Vec<&Section> =
        report.sections.iter().filter(|section| here(&section.split, &section.object)).collect();
    let stated = sections.iter().any(|section| section.consistency.is_some());
    html! {
        @if !sections.is_empty() {
            section {
                h3 { (of.object) }
                div.plots {
                    (PreEscaped(plots::visibility(of)))
                    @if sections.iter().any(|section| section.trust.is_some()) {
                        (PreEscaped(plots::risk(&sections)))
                        (PreEscaped(plots::reliability(&sections)))
                    }
                    @if stated { (PreEscaped(plots::coverage(of))) }
                }
                @for section in &sections { (reasons(section)) }
                @for sheet in sheets.iter().filter(|sheet| here(&sheet.split, &sheet.object)) {
                    h4 { (sheet.title) }
                    div.sheet { @for picture in &sheet.pictures { (shown(picture)) } }
                }
            }
        }
    }
}

fn reasons(section: &Section) -> Markup {
    let counted = |counted: &Counted| format!("{} {} ({} right)", counted.answers, counted.name, counted.right);
    let list = |all: &[Counted]| all.iter().map(counted).collect::<Vec<_>>().join(", ");
    html! {
        p.note {
            "Visible " (section.visible) ": " (list(&section.verdicts.statuses)) "."
            @if !section.verdicts.reasons.is_empty() { " Reasons: " (list(&section.verdicts.reasons)) "." }
        }
    }
}

fn shown(picture: &Picture) -> Markup {
    html! {
        figure {
            img alt=(picture.captions.join(", ")) src=(format!("data:image/jpeg;base64,{}", STANDARD.encode(&picture.jpeg)));
            figcaption { @for line in &picture.captions { (line) br; } }
        }
    }
}

fn words() -> Markup {
    html! {
        h2 { "What the words mean" }
        dl {
            dt { "ADD(-S)" } dd { "Mean distance of the vertices under both poses is below a tenth of the diameter; of the nearest vertex, for an object with symmetries. An answer is right if this holds." }
            dt { "Proj-5" } dd { "Mean distance of the projected vertices is below 5 pixels." }
            dt { "5°5cm" } dd { "Rotation within 5 degrees and translation within 5 cm of the nearest pose that looks the same." }
            dt { "AR (no VSD)" } dd { "Average recall of the BOP benchmark over MSSD and MSPD; without VSD, which needs depth images." }
            dt { "NEES" } dd { "Squared error in units of the stated covariance. The mean of honest covariances is the number of degrees of freedom, 6." }
            dt { "Brier, ECE" } dd { "How far the confidence is from being the probability of a right answer; 0 is best." }
            dt { "Pictures" } dd { "White box: the true pose. Coloured box and axes: the estimate (green ok, yellow ambiguous, orange low confidence, red rejected)." }
        }
    }
}

fn named(section: &Section) -> Markup {
    html! { td { (section.object) } td { (section.visible) } }
}

fn percent(share: Option<f64>, interval: Option<Interval>) -> String {
    let Some(share) = share else { return "–".into() };
    let interval =
        interval.map_or(String::new(), |Interval { low, high }| format!(" ({:.0} to {:.0})", 1e2 * low, 1e2 * high));
    format!("{:.1} %{interval}", 1e2 * share)
}

fn figure(value: Option<f64>) -> String {
    value.map_or("–".into(), |value| format!("{value:.3}"))
}
