use posed_core::pnp::Status;

use super::chart::{Axis, Chart, Kind, Legend, Series};
use crate::evaluation::metrics::PoseNees;
use crate::evaluation::record::Record;
use crate::evaluation::report::{ObjectRecords, Section};

/// Right end of the accuracy curves, of the diameter.
const MOST_ADD: f64 = 0.3;
const STEPS: usize = 60;
const STATUSES: [Status; 4] = [Status::Ok, Status::Ambiguous, Status::LowConfidence, Status::Rejected];

/// Share of views with a smaller ADD(-S), over ADD(-S).
pub(super) fn accuracy(objects: &[ObjectRecords]) -> String {
    let curve = |of: &ObjectRecords| {
        let shares: Vec<f64> = of.records.iter().map(|record| share_of_diameter(record, of.diameter_m)).collect();
        let point = |step: usize| {
            let limit = MOST_ADD * step as f64 / STEPS as f64;
            (limit, shares.iter().filter(|share| **share < limit).count() as f64 / shares.len().max(1) as f64)
        };
        Series::new(of.object.clone(), Kind::Line, (0..=STEPS).map(point).collect())
    };
    let chart = Chart {
        title: "Accuracy by threshold, all ranges of visibility",
        x: Axis::new("ADD(-S), share of the diameter", 0.0..MOST_ADD),
        y: Axis::new("share of views", 0.0..1.0),
        series: objects.iter().map(curve).collect(),
        diagonal: false,
        legend: Legend::LowerRight,
    };
    chart.svg()
}

/// Error over visible fraction, by status.
pub(super) fn visibility(of: &ObjectRecords) -> String {
    let series = STATUSES.iter().map(|status| {
        let has = |record: &&Record| record.said.as_ref().is_some_and(|said| said.answer.status == *status);
        let point = |record: &Record| (record.visible_fraction, share_of_diameter(record, of.diameter_m));
        Series::new(status.to_string(), Kind::Dots, of.records.iter().filter(has).map(point).collect())
    });
    let chart = Chart {
        title: "Error by visibility",
        x: Axis::new("visible fraction", 0.0..1.0),
        y: Axis::new("ADD(-S), share of the diameter (0.5: and more)", 0.0..0.5),
        series: series.filter(|series| !series.points.is_empty()).collect(),
        diagonal: false,
        legend: Legend::UpperRight,
    };
    chart.svg()
}

/// Share that is right over the confidence.
pub(super) fn reliability(sections: &[&Section]) -> String {
    let of_section = |section: &&Section| {
        let bins = section.trust.iter().flat_map(|trust| &trust.bins);
        let points = bins.filter_map(|bin| Some((bin.mean_confidence?, bin.share_right?))).collect();
        Series::new(format!("visible {}", section.visible), Kind::Line, points)
    };
    let chart = Chart {
        title: "Is the confidence a probability?",
        x: Axis::new("confidence", 0.0..1.0),
        y: Axis::new("share that is right", 0.0..1.0),
        series: sections.iter().map(of_section).collect(),
        diagonal: true,
        legend: Legend::UpperLeft,
    };
    chart.svg()
}

/// Share that is wrong among the most confident.
pub(super) fn risk(sections: &[&Section]) -> String {
    let of_section = |section: &&Section| {
        let points = section.trust.iter().flat_map(|trust| &trust.risk_coverage);
        let points = points.map(|point| (point.coverage, point.risk)).collect();
        Series::new(format!("visible {}", section.visible), Kind::Line, points)
    };
    let chart = Chart {
        title: "Risk by coverage",
        x: Axis::new("share of answers that is believed, most confident first", 0.0..1.0),
        y: Axis::new("share of these that is wrong", 0.0..1.0),
        series: sections.iter().map(of_section).collect(),
        diagonal: false,
        legend: Legend::UpperLeft,
    };
    chart.svg()
}

/// Share of errors within an ellipsoid over the share that it should hold, of `ok` poses.
pub(super) fn coverage(of: &ObjectRecords) -> String {
    let nees: Vec<PoseNees> =
        of.records.iter().filter(|record| record.is_ok()).filter_map(|record| record.said.as_ref()?.nees).collect();
    let series = ["pose", "depth", "lateral", "rotation"].map(|name| {
        let part = |nees: &PoseNees| match name {
            "depth" => nees.depth,
            "lateral" => nees.lateral,
            "rotation" => nees.rotation,
            _ => nees.pose,
        };
        let mut levels: Vec<f64> = nees.iter().filter_map(|nees| part(nees).level()).collect();
        levels.sort_by(f64::total_cmp);
        let point = |(place, level): (usize, &f64)| (*level, (place + 1) as f64 / levels.len() as f64);
        let points = std::iter::once((0.0, 0.0)).chain(levels.iter().enumerate().map(point)).collect();
        Series::new(name, Kind::Line, points)
    });
    let chart = Chart {
        title: "Are the covariances honest? (ok poses, all ranges)",
        x: Axis::new("share that the ellipsoid should hold", 0.0..1.0),
        y: Axis::new("share of errors within it", 0.0..1.0),
        series: series.into(),
        diagonal: true,
        legend: Legend::UpperLeft,
    };
    chart.svg()
}

/// Infinite where there is no pose.
fn share_of_diameter(record: &Record, diameter_m: f64) -> f64 {
    record.deviation().map_or(f64::INFINITY, |deviation| deviation.add_m / diameter_m)
}
