/// Which true instance each answer means, one to one. Answers choose in their order, each the instance that costs least of those
/// that are free; `None` as a cost says that it cannot be meant.
#[must_use]
pub fn assign(answers: usize, instances: usize, cost: impl Fn(usize, usize) -> Option<f64>) -> Vec<Option<usize>> {
    let mut free = vec![true; instances];
    let mut choose = |answer: usize| {
        let costs = (0..instances).filter(|instance| free[*instance]).filter_map(|i| Some((i, cost(answer, i)?)));
        let chosen = costs.min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(instance, _)| instance)?;
        free[chosen] = false;
        Some(chosen)
    };
    (0..answers).map(&mut choose).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_instance_is_meant_once_and_the_first_answer_chooses_first() {
        let costs = [[3.0, 1.0], [9.0, 0.5], [0.1, 0.1]];
        let meant = assign(3, 2, |answer, instance| Some(costs[answer][instance]).filter(|cost| *cost < 5.0));
        // The second would have taken the same instance; the third finds the other one.
        assert_eq!(meant, [Some(1), None, Some(0)]);
        assert_eq!(assign(2, 0, |_, _| Some(0.0)), [None, None]);
    }
}
