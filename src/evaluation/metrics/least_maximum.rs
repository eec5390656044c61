/// The least, over candidates, of the largest value that any item has for a candidate, without looking at all pairs: exact.
///
/// The largest value over a few items is a lower bound for each candidate. The candidate with the least bound is looked at in
/// full, and the item that was largest there joins the few, which raises the bounds of the others, until the least bound is a
/// true value. Items that decide are few, and so are the candidates that are looked at in full.
///
/// `first` names the items to start with. Infinite without candidates, 0 without items. Values must not be NaN.
pub(super) fn least_maximum(
    candidates: usize,
    items: usize,
    first: &[usize],
    value: impl Fn(usize, usize) -> f64,
) -> f64 {
    let over = |candidate: usize, some: &[usize]| some.iter().map(|item| value(candidate, *item)).fold(0.0, f64::max);
    let mut bounds: Vec<_> = (0..candidates).map(|candidate| (over(candidate, first), false)).collect();
    loop {
        let least = (0..candidates).min_by(|a, b| bounds[*a].0.total_cmp(&bounds[*b].0));
        let Some(least) = least else { return f64::INFINITY };
        if let (exact, true) = bounds[least] {
            return exact;
        }
        let (mut largest, mut at) = (0.0, None);
        for item in 0..items {
            let value = value(least, item);
            if value > largest {
                (largest, at) = (value, Some(item));
            }
        }
        for (candidate, (bound, exact)) in bounds.iter_mut().enumerate() {
            if let (false, Some(item)) = (*exact, at) {
                *bound = bound.max(value(candidate, item));
            }
        }
        bounds[least] = (largest, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn nothing_is_overlooked(
            table in prop::collection::vec(prop::collection::vec(prop_oneof![0.0..9.0f64, Just(f64::INFINITY)], 12), 1..20),
            first in prop::collection::vec(0..12usize, 0..4),
        ) {
            let maxima = table.iter().map(|row| row.iter().copied().fold(0.0, f64::max));
            let expected = maxima.fold(f64::INFINITY, f64::min);
            let found = least_maximum(table.len(), 12, &first, |candidate, item| table[candidate][item]);
            prop_assert_eq!(found.to_bits(), expected.to_bits());
        }
    }

    #[test]
    fn few_candidates_are_looked_at_in_full() {
        let calls = std::cell::Cell::new(0);
        let wave = |candidate: usize, item: usize| {
            calls.set(calls.get() + 1);
            ((candidate as f64) * 0.02 - 3.0).abs() * (item as f64 + 1.0)
        };
        assert!(least_maximum(300, 1000, &[0], wave) < 1e-9);
        assert!(calls.get() < 300 * 1000 / 20, "{}", calls.get());
    }
}
