use std::path::Path;

use serde::Serialize;

use crate::evaluation::agreement::{BLIND_SPOTS, Bounds, Quantiles, SceneAgreement, Spread, Totals, warnings};

/// What `--json` writes: metres and degrees.
#[derive(Serialize)]
pub(super) struct Report<'a> {
    split: String,
    bounds: Bounds,
    blind_spots: &'static str,
    objects: Vec<ObjectReport>,
    /// Scenes and images that were left out, and why.
    skipped: &'a [String],
}

#[derive(Serialize)]
pub(super) struct ObjectReport {
    object: String,
    diameter_m: f64,
    #[serde(flatten)]
    totals: Totals,
    warnings: Vec<String>,
    scenes: Vec<SceneAgreement>,
}

impl ObjectReport {
    pub(super) fn new(object: &str, diameter_m: f64, images: usize, scenes: Vec<SceneAgreement>) -> Self {
        let totals = Totals::of(images, &scenes);
        let warnings = warnings(&totals, &scenes, diameter_m);
        Self { object: object.into(), diameter_m, totals, warnings, scenes }
    }

    fn row(&self) -> String {
        let Self { object, totals, .. } = self;
        let spread = totals.spread_of_ok.as_ref();
        let cell = |text: &dyn Fn(&Spread) -> String| spread.map_or_else(|| "-".into(), text);
        let mm = |quantiles: &Quantiles| format!("{:.1} / {:.1}", 1e3 * quantiles.median, 1e3 * quantiles.p90);
        let cells = [
            object.clone(),
            totals.images.to_string(),
            totals.instances.to_string(),
            totals.answers.to_string(),
            totals.ok.to_string(),
            totals.ok_disagreeing.to_string(),
            totals.ok_flipped.to_string(),
            totals.ok_alone.to_string(),
            cell(&|spread| mm(&spread.translation_m)),
            cell(&|spread| mm(&spread.depth_m)),
            cell(&|spread| format!("{:.2} / {:.2}", spread.rotation_deg.median, spread.rotation_deg.p90)),
            cell(&|spread| format!("{:.1}", spread.nees_median)),
            cell(&|spread| format!("{:.0}", 100.0 * spread.within_95)),
            totals.view_angle_deg.map_or_else(|| "-".into(), |angle| format!("{angle:.0}")),
        ];
        format!("| {} |", cells.join(" | "))
    }
}

/// The cells above those of [`ObjectReport::row`].
const HEAD: [&str; 14] = [
    "object",
    "images",
    "instances",
    "answers",
    "ok",
    "ok, disagree",
    "ok, flipped",
    "ok, alone",
    "translation, median / p90 (mm)",
    "depth (mm)",
    "rotation (deg)",
    "NEES, median",
    "within 95 %",
    "views apart (deg)",
];

impl<'a> Report<'a> {
    pub(super) fn new(split: &Path, bounds: Bounds, objects: Vec<ObjectReport>, skipped: &'a [String]) -> Self {
        Self { split: split.display().to_string(), bounds, blind_spots: BLIND_SPOTS, objects, skipped }
    }

    /// What is printed.
    pub(super) fn text(&self) -> String {
        let mut lines = Vec::new();
        let Bounds { translation_of_diameter, rotation_deg, flip_deg } = self.bounds;
        lines.push(format!("{}: each ok answer against the other views of its object", self.split));
        lines.push(format!(
            "disagree: by more than {:.0} % of the diameter or {rotation_deg:.0} degrees; flipped: by {flip_deg:.0} degrees or \
             more; true covariances have NEES 5.3 and 95 %\n",
            100.0 * translation_of_diameter
        ));
        lines.push(format!("| {} |", HEAD.join(" | ")));
        lines.push(format!("|{}", "---|".repeat(HEAD.len())));
        lines.extend(self.objects.iter().map(ObjectReport::row));
        lines.push(String::new());
        for object in &self.objects {
            for warning in &object.warnings {
                lines.push(format!("{}: {warning}", object.object));
            }
        }
        lines.push(format!("{BLIND_SPOTS}\n"));
        lines.join("\n")
    }

    /// Whether any pose could be compared with another.
    pub(super) fn compares(&self) -> bool {
        self.objects.iter().any(|object| object.totals.spread_of_all.is_some())
    }
}
