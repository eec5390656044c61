use std::fmt::Write as _;

use super::score::Row;

/// A Markdown table, one line for each object and number of views.
pub(super) fn table(rows: &[Row], wrong_views: usize) -> String {
    let mut text = String::from(
        "| object | views | poses | ADD(-S) % | 5°5cm % | ADD(-S), median (mm) | p90 (mm) | ok % | ok but wrong % | NEES of ok, \
         mean, median | in 95 % |",
    );
    text.push_str(if wrong_views > 0 { " wrong views named %, and no other % |\n" } else { "\n" });
    text.push_str(&"|---".repeat(if wrong_views > 0 { 12 } else { 11 }));
    text.push_str("|\n");
    for row in rows {
        let mm = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
        let nees = row.nees_mean.zip(row.nees_median);
        let nees = nees.map_or("-".into(), |(mean, median)| format!("{mean:.1}, {median:.1}"));
        let within = row.within_95.map_or("-".into(), |share| format!("{:.1}", 100.0 * share));
        // Writing into a string cannot fail.
        let _ = write!(
            text,
            "| {} | {} | {} | {:.1} | {:.1} | {} | {} | {:.1} | {:.1} | {nees} | {within} |",
            row.object,
            row.views,
            row.poses,
            100.0 * row.add,
            100.0 * row.deg5_cm5,
            mm(row.median_add_mm),
            mm(row.p90_add_mm),
            100.0 * row.ok,
            100.0 * row.ok_wrong,
        );
        let _ = if wrong_views > 0 {
            writeln!(text, " {:.1}, {:.1} |", 100.0 * row.named, 100.0 * row.named_alone)
        } else {
            writeln!(text)
        };
    }
    text
}
