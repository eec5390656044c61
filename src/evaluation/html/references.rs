use serde::Serialize;

use super::chart::{Axis, Chart, Kind, Legend, Series};

/// Accuracy over the number of references, a plot for each way of averaging them. A plot's curves have the same numbers.
#[must_use]
pub fn references_plot(plots: &[(String, Vec<ReferencesCurve>)]) -> String {
    Chart::row(&plots.iter().map(|(title, curves)| chart(title, curves)).collect::<Vec<_>>())
}

fn chart<'a>(title: &'a str, curves: &[ReferencesCurve]) -> Chart<'a> {
    let series = |(place, curve): (usize, &ReferencesCurve)| {
        // Beside each other, so that whiskers do not hide each other.
        let shift = 0.06 * (place as f64 - 0.5 * (curves.len() as f64 - 1.0));
        let x = |place: usize| place as f64 + shift;
        let points = curve.points.iter().enumerate().map(|(place, point)| (x(place), point.mean)).collect();
        let spread = |(place, point): (usize, &Spread)| (x(place), point.least, point.most);
        let whiskers = curve.points.iter().enumerate().map(spread).collect();
        Series { whiskers, ..Series::new(curve.object.clone(), Kind::Line, points) }
    };
    let ticks = curves.first().map_or(Vec::new(), |curve| curve.references.clone());
    let range = -0.3..ticks.len() as f64 - 0.7;
    Chart {
        title,
        x: Axis { ticks, ..Axis::new("references; mean, least and most of the draws", range) },
        y: Axis::new("share of views with ADD(-S) below a tenth", 0.0..1.0),
        series: curves.iter().enumerate().map(series).collect(),
        diagonal: false,
        legend: Legend::LowerRight,
    }
}

/// One object's accuracy over the number of references.
pub struct ReferencesCurve {
    pub object: String,
    /// How many, in words: `1`, `3`, `all`.
    pub references: Vec<String>,
    pub points: Vec<Spread>,
}

/// A figure over several draws.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    pub mean: f64,
    pub least: f64,
    pub most: f64,
}
