//! Whether memory grows.

use crate::watch::Sample;

/// A straight line through measurements, by least squares.
pub struct Trend {
    pub mib_per_hour: f64,
    pub standard_error: f64,
    pub means: usize,
    pub block_s: f64,
}

/// Neighbouring samples are alike, and would pretend to know the slope well: the line goes through means of so many.
const MEANS: usize = 30;

impl Trend {
    pub fn of(samples: &[Sample]) -> Self {
        let size = samples.len().div_ceil(MEANS).max(1);
        let mean = |block: &[Sample], of: fn(&Sample) -> f64| block.iter().map(of).sum::<f64>() / block.len() as f64;
        let points: Vec<(f64, f64)> = samples
            .chunks_exact(size)
            .map(|block| (mean(block, |sample| sample.at.as_secs_f64() / 3600.0), mean(block, |sample| sample.mib)))
            .collect();
        let count = points.len() as f64;
        let centre = points.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0 / count, sum.1 + point.1 / count));
        let width: f64 = points.iter().map(|point| (point.0 - centre.0).powi(2)).sum();
        let slope = points.iter().map(|point| (point.0 - centre.0) * (point.1 - centre.1)).sum::<f64>() / width;
        let rest = points.iter().map(|point| (point.1 - centre.1 - slope * (point.0 - centre.0)).powi(2)).sum::<f64>();
        let standard_error = (rest / (count - 2.0) / width).sqrt();
        let time = samples.last().map_or(0.0, |last| last.at.as_secs_f64() - samples[0].at.as_secs_f64());
        let block_s = time * size as f64 / samples.len() as f64;
        Self { mib_per_hour: slope, standard_error, means: points.len(), block_s }
    }
}
