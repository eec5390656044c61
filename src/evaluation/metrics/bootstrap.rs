use serde::Serialize;

use super::statistics::quantile;

/// Share of draws on either side of an interval.
const TAIL: f64 = 0.025;

/// Where 95 % of the draws of a statistic lie.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The 2.5 % quantile.
    pub low: f64,
    /// The 97.5 % quantile.
    pub high: f64,
}

/// Percentile intervals from a cluster bootstrap: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapter 13; Davison
/// and Hinkley, Bootstrap Methods and their Application (1997), section 3.8 for clusters.
#[derive(Clone, Copy, Debug)]
pub struct Bootstrap {
    /// How often the clusters are drawn anew.
    pub draws: usize,
    /// The same seed gives the same interval.
    pub seed: u64,
}

impl Default for Bootstrap {
    fn default() -> Self {
        Self { draws: 1_000, seed: 0 }
    }
}

impl Bootstrap {
    /// The interval of a statistic of all members of all clusters. What may be alike, as the views of one image, belongs in one
    /// cluster, and is drawn together. The statistic is `None` where it is not defined; such draws are left out.
    ///
    /// `None` with fewer than two clusters that have members, or if the statistic is never defined.
    pub fn interval<T: Clone>(&self, clusters: &[Vec<T>], statistic: impl Fn(&[T]) -> Option<f64>) -> Option<Interval> {
        let [interval] = self.intervals(clusters, |members| [statistic(members)]);
        interval
    }

    /// [`Bootstrap::interval`] of several statistics of the same draws.
    pub fn intervals<T: Clone, const N: usize>(
        &self,
        clusters: &[Vec<T>],
        statistics: impl Fn(&[T]) -> [Option<f64>; N],
    ) -> [Option<Interval>; N] {
        let clusters: Vec<_> = clusters.iter().filter(|cluster| !cluster.is_empty()).collect();
        if clusters.len() < 2 {
            return [None; N];
        }
        let mut random = fastrand::Rng::with_seed(self.seed);
        let mut members = Vec::new();
        let mut values = [const { Vec::new() }; N];
        for _ in 0..self.draws {
            members.clear();
            for _ in 0..clusters.len() {
                members.extend_from_slice(clusters[random.usize(..clusters.len())]);
            }
            for (values, value) in values.iter_mut().zip(statistics(&members)) {
                values.extend(value.filter(|value| !value.is_nan()));
            }
        }
        values.map(Interval::of)
    }
}

impl Interval {
    fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        Some(Self { low: quantile(&values, TAIL)?, high: quantile(&values, 1.0 - TAIL)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::metrics::statistics::{mean, median};

    fn share_right(views: &[bool]) -> Option<f64> {
        mean(views.iter().map(|right| f64::from(u8::from(*right))))
    }

    #[test]
    fn the_interval_of_a_share_is_that_of_the_binomial() {
        let views: Vec<_> = (0..400).map(|k| vec![k % 5 != 0]).collect();
        let Interval { low, high } = Bootstrap::default().interval(&views, share_right).unwrap();
        // 0.8 -+ 1.96 sqrt(0.8 * 0.2 / 400)
        assert!((low - 0.7608).abs() < 0.006 && (high - 0.8392).abs() < 0.006, "{low} {high}");
    }

    #[test]
    fn views_of_an_image_are_drawn_together() {
        // As many views as above, but all of an image are right or wrong: the width is that of 40 images.
        let images: Vec<_> = (0..40).map(|k| vec![k % 5 != 0; 10]).collect();
        let Interval { low, high } = Bootstrap::default().interval(&images, share_right).unwrap();
        assert!(high - low > 0.2 && low > 0.6 && high < 0.95, "{low} {high}");
    }

    #[test]
    fn the_same_seed_gives_the_same_interval_and_medians_work() {
        let clusters: Vec<_> = (0..101).map(|k| vec![f64::from(k * k)]).collect();
        let middle = |values: &[f64]| median(values.iter().copied());
        let interval = |seed| Bootstrap { seed, ..Bootstrap::default() }.interval(&clusters, middle).unwrap();
        assert_eq!(interval(7), interval(7));
        assert_ne!(interval(7), interval(8));
        assert!((interval(7).low..interval(7).high).contains(&2500.0));
        let infinite = vec![vec![f64::INFINITY], vec![f64::INFINITY], vec![1.0]];
        let interval = Bootstrap::default().interval(&infinite, middle).unwrap();
        assert_eq!((interval.low, interval.high), (1.0, f64::INFINITY));
    }

    #[test]
    fn one_image_or_no_statistic_has_no_interval() {
        assert_eq!(Bootstrap::default().interval(&[vec![true, false]], share_right), None);
        assert_eq!(Bootstrap::default().interval(&[vec![true], Vec::new()], share_right), None);
        assert_eq!(Bootstrap::default().interval(&[vec![1], vec![2]], |_| None), None);
    }
}
