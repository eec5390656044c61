/// The quantile of sorted values, linear between them; `None` of nothing. Infinite values are kept, NaN is not expected.
pub(super) fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let position = share.clamp(0.0, 1.0) * sorted.len().checked_sub(1)? as f64;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and the length")]
    let below = position as usize;
    let (low, fraction) = (*sorted.get(below)?, position.fract());
    let high = sorted.get(below + 1).copied().unwrap_or(low);
    // Infinity times 0, or less infinity, is not a number.
    Some(if fraction > 0.0 && low < high { low * (1.0 - fraction) + high * fraction } else { low })
}

/// The middle value, or the mean of the two middle ones; `None` of nothing.
pub(super) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<_> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    quantile(&values, 0.5)
}

/// `None` of nothing.
pub(super) fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.into_iter().fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// One count over another; `None` over nothing.
pub(super) fn share(part: usize, all: usize) -> Option<f64> {
    (all > 0).then(|| part as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_quantiles_lie_between_values() {
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median([]), None);
        assert_eq!(median([1.0, f64::INFINITY, f64::INFINITY]), Some(f64::INFINITY));
        assert_eq!(median([1.0, f64::INFINITY]), Some(f64::INFINITY));
        assert_eq!(median([1.0, 2.0, f64::INFINITY]), Some(2.0));
        assert_eq!(quantile(&[0.0, 1.0, 2.0, 3.0, 4.0], 0.975), Some(3.9));
        assert_eq!(quantile(&[0.0, 1.0], 0.0), Some(0.0));
        assert_eq!((mean([]), mean([1.0, 2.0]), share(1, 0), share(1, 4)), (None, Some(1.5), None, Some(0.25)));
    }
}
