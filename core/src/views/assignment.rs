//! Rows to columns, one to one, at the least total cost.

/// For each row its column, or `None` where leaving it out costs less: each row costs 0 without a column, so only costs below 0
/// are worth taking. The shortest augmenting paths of Jonker and Volgenant, "A shortest augmenting path algorithm for dense
/// and sparse linear assignment problems", Computing 1987.
pub(super) fn assign(rows: usize, columns: usize, cost: impl Fn(usize, usize) -> f64) -> Vec<Option<usize>> {
    // A column of its own for each row, at no cost.
    let width = columns + rows;
    let cost = |row: usize, column: usize| if column < columns { cost(row, column).min(0.0) } else { 0.0 };
    let mut prices = vec![0.0; width];
    let mut of_rows = vec![0.0; rows];
    let mut taken: Vec<Option<usize>> = vec![None; width];
    for first in 0..rows {
        let mut least = vec![f64::INFINITY; width];
        let mut before: Vec<Option<usize>> = vec![None; width];
        let mut done = vec![false; width];
        let (mut row, mut from) = (first, None);
        let end = loop {
            let (mut next, mut shortest) = (0, f64::INFINITY);
            for column in (0..width).filter(|column| !done[*column]) {
                let reduced = cost(row, column) - of_rows[row] - prices[column];
                if reduced < least[column] {
                    (least[column], before[column]) = (reduced, from);
                }
                if least[column] < shortest {
                    (next, shortest) = (column, least[column]);
                }
            }
            of_rows[first] += shortest;
            for column in 0..width {
                if done[column] {
                    prices[column] -= shortest;
                    if let Some(row) = taken[column] {
                        of_rows[row] += shortest;
                    }
                } else {
                    least[column] -= shortest;
                }
            }
            done[next] = true;
            match taken[next] {
                None => break next,
                Some(other) => (row, from) = (other, Some(next)),
            }
        };
        let mut column = end;
        while let Some(previous) = before[column] {
            taken[column] = taken[previous];
            column = previous;
        }
        taken[column] = Some(first);
    }
    let mut of_row = vec![None; rows];
    for (column, row) in taken.into_iter().enumerate().take(columns) {
        if let Some(row) = row.filter(|row| cost(*row, column) < 0.0) {
            of_row[row] = Some(column);
        }
    }
    of_row
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least total cost, by trying everything.
    fn least(costs: &[Vec<f64>], row: usize, free: &mut Vec<bool>) -> f64 {
        let Some(of_row) = costs.get(row) else { return 0.0 };
        let mut best = least(costs, row + 1, free);
        for (column, cost) in of_row.iter().enumerate() {
            if free[column] {
                free[column] = false;
                best = best.min(cost + least(costs, row + 1, free));
                free[column] = true;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn nothing_costs_less(costs in (0..5usize).prop_flat_map(|columns| {
            prop::collection::vec(prop::collection::vec(-5.0..2.0f64, columns), 0..5)
        })) {
            let columns = costs.first().map_or(0, Vec::len);
            let assigned = assign(costs.len(), columns, |row, column| costs[row][column]);
            let mut seen = vec![0; columns];
            assigned.iter().flatten().for_each(|column| seen[*column] += 1);
            prop_assert!(seen.iter().all(|times| *times <= 1), "{assigned:?}");
            let total: f64 = assigned.iter().enumerate().filter_map(|(row, column)| Some(costs[row][(*column)?])).sum();
            let best = least(&costs, 0, &mut vec![true; columns]);
            prop_assert!((total - best).abs() < 1e-9, "{total} {best} {assigned:?}");
        }
    }
}
