/// So many items are looked at before the other candidates' bounds are.
const CHUNK: usize = 8192;

/// The least, over candidates, of the largest value that any item has for a candidate, without looking at all pairs: exact.
///
/// The largest value over a few items is a lower bound for each candidate. The candidate with the least bound is looked at,
/// until it is no longer the least or all its items were seen. The item that was largest there raises the bounds of the others,
/// too. Once the least bound is over all items, it is the answer. Items that decide are few, and so are candidates that are looked
/// at in full.
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
        let others = (0..candidates).filter(|other| *other != least).map(|other| bounds[other].0);
        let next = others.fold(f64::INFINITY, f64::min);
        let (mut largest, mut at, mut looked_at) = (bounds[least].0, None, 0);
        // Once another candidate has a lower bound, that one is looked at.
        while looked_at < items && largest <= next {
            let until = items.min(looked_at + CHUNK);
            for item in looked_at..until {
                let value = value(least, item);
                if value > largest {
                    (largest, at) = (value, Some(item));
                }
            }
            looked_at = until;
        }
        for (candidate, (bound, exact)) in bounds.iter_mut().enumerate() {
            if let (false, Some(item)) = (*exact, at) {
                *bound = bound.max(value(candidate, item));
            }
        }
        bounds[least] = (largest, looked_at == items);
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
            // Each value many times over, so that a candidate may be left half way.
            let first: Vec<_> = first.into_iter().map(|item| item * CHUNK / 3).collect();
            let found = least_maximum(table.len(), 4 * CHUNK, &first, |candidate, item| table[candidate][3 * item / CHUNK]);
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
