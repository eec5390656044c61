//! Many measurements in few numbers.
#![allow(dead_code, unreachable_pub, reason = "each bench uses a part of this")]

pub fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
}

/// Median, 99th percentile, and the most.
pub fn spread(values: &[f64]) -> String {
    format!("{:.1} / {:.1} / {:.1}", median(values), quantile(values, 0.99), quantile(values, 1.0))
}
