use serde::Serialize;

use super::statistics::{mean, share};

/// Bins of a reliability plot, of equal width.
const BINS: usize = 10;

/// How sure the answer was, and whether it was right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Claim {
    /// 0..1.
    pub confidence: f64,
    /// Of the pose.
    pub right: bool,
}

/// Whether confidences are the chance of being right, and whether they sort right from wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trust {
    /// Claims with a confidence from 0 to 1.
    pub count: usize,
    /// Claims with another confidence, or with NaN; the rest leaves them out.
    pub unusable: usize,
    /// Mean squared difference of the confidence from 1 (right) or 0 (wrong): Brier (Monthly Weather Review, 1950). 0 is best.
    pub brier: f64,
    /// Expected calibration error: the mean difference, over claims, of their bin's confidence from its share that is right. Naeini
    /// et al. (AAAI 2015); Guo et al. (ICML 2017), equation 3. 0 is best.
    pub ece: f64,
    /// Ten bins of equal width from 0 to 1, empty ones among them: a reliability plot.
    pub bins: Vec<ReliabilityBin>,
    /// Share that is wrong among the most confident: Geifman and El-Yaniv (NeurIPS 2017). Grows in coverage; claims of equal
    /// confidence are one step.
    pub risk_coverage: Vec<RiskPoint>,
    /// Area under that curve, a step as high as its end: the mean risk over all coverages. 0 is best.
    pub aurc: f64,
}

/// One bin of a reliability plot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReliabilityBin {
    /// Smallest confidence in the bin; the next bin's is outside it, but 1 is in the last.
    pub from: f64,
    /// Claims.
    pub count: usize,
    /// `None` in an empty bin.
    pub mean_confidence: Option<f64>,
    /// `None` in an empty bin.
    pub share_right: Option<f64>,
}

/// A point of a risk-coverage curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RiskPoint {
    /// The smallest confidence that is still believed.
    pub confidence: f64,
    /// Share of claims that are believed.
    pub coverage: f64,
    /// Share of these that are wrong.
    pub risk: f64,
}

impl Trust {
    /// `None` without a usable claim.
    #[must_use]
    pub fn of(claims: &[Claim]) -> Option<Self> {
        let mut usable: Vec<_> = claims.iter().filter(|claim| (0.0..=1.0).contains(&claim.confidence)).collect();
        usable.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        let squared = |claim: &&Claim| (claim.confidence - f64::from(u8::from(claim.right))).powi(2);
        let bins: Vec<_> = (0..BINS).map(|bin| ReliabilityBin::of(bin, &usable)).collect();
        let gap = |bin: &ReliabilityBin| {
            Some(bin.count as f64 * (bin.mean_confidence? - bin.share_right?).abs() / usable.len() as f64)
        };
        let risk_coverage = risk_coverage(&usable);
        let mut before = 0.0;
        let steps = risk_coverage.iter().map(|point| {
            let width = point.coverage - before;
            before = point.coverage;
            width * point.risk
        });
        Some(Self {
            count: usable.len(),
            unusable: claims.len() - usable.len(),
            brier: mean(usable.iter().map(squared))?,
            ece: bins.iter().filter_map(gap).sum(),
            aurc: steps.sum(),
            bins,
            risk_coverage,
        })
    }
}

impl ReliabilityBin {
    fn of(bin: usize, claims: &[&Claim]) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and 10")]
        let bin_of = |claim: &Claim| ((claim.confidence * BINS as f64) as usize).min(BINS - 1);
        let inside: Vec<_> = claims.iter().filter(|claim| bin_of(claim) == bin).collect();
        Self {
            from: bin as f64 / BINS as f64,
            count: inside.len(),
            mean_confidence: mean(inside.iter().map(|claim| claim.confidence)),
            share_right: share(inside.iter().filter(|claim| claim.right).count(), inside.len()),
        }
    }
}

/// Of claims that are sorted, the most confident first.
#[allow(clippy::float_cmp, reason = "ties are equal numbers")]
fn risk_coverage(sorted: &[&Claim]) -> Vec<RiskPoint> {
    let (mut believed, mut wrong) = (0, 0);
    let step = |tie: &[&Claim]| {
        believed += tie.len();
        wrong += tie.iter().filter(|claim| !claim.right).count();
        let confidence = tie.first()?.confidence;
        Some(RiskPoint { confidence, coverage: share(believed, sorted.len())?, risk: share(wrong, believed)? })
    };
    sorted.chunk_by(|a, b| a.confidence == b.confidence).filter_map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn claims(all: &[(f64, bool)]) -> Vec<Claim> {
        all.iter().map(|&(confidence, right)| Claim { confidence, right }).collect()
    }

    #[test]
    fn numbers_are_those_worked_out_by_hand() {
        let trust =
            Trust::of(&claims(&[(0.95, true), (0.92, true), (0.9, false), (0.35, false), (0.3, true)])).unwrap();
        let brier = (0.05_f64.powi(2) + 0.08_f64.powi(2) + 0.9_f64.powi(2) + 0.35_f64.powi(2) + 0.7_f64.powi(2)) / 5.0;
        assert!((trust.brier - brier).abs() < 1e-12);
        // Bin 0.9: mean 0.92333 against 2/3. Bin 0.3: mean 0.325 against 1/2.
        let ece = (3.0 * (2.77 / 3.0 - 2.0 / 3.0) + 2.0 * (0.5 - 0.325)) / 5.0;
        assert!((trust.ece - ece).abs() < 1e-12, "{}", trust.ece);
        assert_eq!(trust.bins.iter().map(|bin| bin.count).collect::<Vec<_>>(), [0, 0, 0, 2, 0, 0, 0, 0, 0, 3]);
        assert_eq!((trust.bins[3].share_right, trust.bins[4].share_right), (Some(0.5), None));
        let risks: Vec<_> = trust.risk_coverage.iter().map(|point| point.risk).collect();
        assert_eq!(risks, [0.0, 0.0, 1.0 / 3.0, 0.5, 0.4]);
        assert!((trust.aurc - risks.iter().sum::<f64>() / 5.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_confidence_is_counted() {
        let trust =
            Trust::of(&claims(&[(f64::NAN, true), (1.1, true), (-0.1, false), (1.0, true), (0.0, false)])).unwrap();
        assert_eq!((trust.count, trust.unusable, trust.bins[9].count, trust.bins[0].count), (2, 3, 1, 1));
        assert_eq!((trust.brier, trust.ece, trust.aurc), (0.0, 0.0, 0.25));
        assert_eq!(Trust::of(&claims(&[(f64::NAN, true)])), None);
    }

    proptest! {
        /// Of few distinct confidences, so that there are ties.
        #[test]
        fn the_order_of_claims_does_not_matter(
            (all, shuffled) in prop::collection::vec((0..5u8, any::<bool>()), 1..30)
                .prop_map(|all| all.into_iter().map(|(step, right)| (f64::from(step) / 4.0, right)).collect::<Vec<_>>())
                .prop_flat_map(|all| (Just(all.clone()), Just(all).prop_shuffle())),
        ) {
            let [first, second] = [&all, &shuffled].map(|list| Trust::of(&claims(list)).unwrap());
            prop_assert_eq!(&first.risk_coverage, &second.risk_coverage);
            prop_assert!((first.aurc - second.aurc).abs() < 1e-12 && (first.ece - second.ece).abs() < 1e-12);
            // All are believed in the end.
            let wrong = all.iter().filter(|(_, right)| !right).count() as f64 / all.len() as f64;
            let last = first.risk_coverage.last().unwrap();
            prop_assert!((last.coverage - 1.0).abs() < 1e-12 && (last.risk - wrong).abs() < 1e-12);
        }
    }
}
