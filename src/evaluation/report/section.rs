use serde::Serialize;

use super::seen::{Seen, by_image};
use super::verdicts::Verdicts;
use crate::evaluation::metrics::{Bootstrap, Claim, Consistency, Interval, Recall, ScoredView, Trust};
use crate::evaluation::visibility::VisibleRange;

/// How well one object is found in one range of visibility.
#[derive(Clone, Debug, Serialize)]
pub struct Section {
    /// The folder of the split.
    pub split: String,
    pub object: String,
    pub visible: VisibleRange,
    pub images: usize,
    pub recall: Recall,
    pub intervals: Intervals,
    pub verdicts: Verdicts,
    /// Of the `ok` poses; `None` where the estimator states no covariances.
    pub consistency: Option<Consistency>,
    /// Of all answers' confidence; `None` where there is none, or it is no probability.
    pub trust: Option<Trust>,
    /// Share of true boxes that the detector found; `None` where there was no detector.
    pub detector_recall: Option<f64>,
}

/// 95 % intervals, by bootstrap over images: views of one image are drawn together.
#[derive(Clone, Debug, Serialize)]
pub struct Intervals {
    pub add: Option<Interval>,
    pub proj5: Option<Interval>,
    pub deg5_cm5: Option<Interval>,
    pub ar_without_vsd: Option<Interval>,
    /// Share of `ok` answers that are wrong.
    pub ok_wrong: Option<Interval>,
    pub median_rotation_deg: Option<Interval>,
    pub median_translation_m: Option<Interval>,
}

impl Section {
    /// `None` without views.
    pub(super) fn new(
        split: &str,
        object: &str,
        visible: VisibleRange,
        has_detector: bool,
        seen: &[Seen<'_>],
    ) -> Option<Self> {
        let images = by_image(seen);
        let views: Vec<ScoredView> = seen.iter().map(|one| one.view).collect();
        let said = || seen.iter().filter_map(|one| one.record.said.as_ref());
        let ok: Vec<_> =
            seen.iter().filter(|one| one.record.is_ok()).filter_map(|one| one.record.said.as_ref()).collect();
        let stated = ok.iter().any(|said| said.answer.covariance.is_some());
        Some(Self {
            split: split.into(),
            object: object.into(),
            visible,
            images: images.len(),
            recall: Recall::of(&views)?,
            intervals: Intervals::of(&images),
            verdicts: Verdicts::of(seen),
            consistency: stated.then(|| Consistency::of(&ok.iter().map(|said| said.nees).collect::<Vec<_>>())),
            trust: trust(seen),
            detector_recall: has_detector.then(|| said().count() as f64 / seen.len() as f64),
        })
    }
}

/// `None` where no answer has a confidence that could be a probability.
fn trust(seen: &[Seen<'_>]) -> Option<Trust> {
    let claim = |one: &Seen<'_>| {
        let said = one.record.said.as_ref()?;
        Some(Claim { confidence: said.answer.confidence, right: one.view.is_right() })
    };
    // Scores that are no probabilities say nothing of those that could be.
    Trust::of(&seen.iter().filter_map(claim).collect::<Vec<_>>()).filter(|trust| trust.unusable == 0)
}

impl Intervals {
    fn of(images: &[Vec<Seen<'_>>]) -> Self {
        let bootstrap = Bootstrap::default();
        let figures = |seen: &[Seen<'_>]| match Recall::of(&seen.iter().map(|one| one.view).collect::<Vec<_>>()) {
            None => [None; 6],
            Some(recall) => [
                Some(recall.add),
                Some(recall.proj5),
                recall.within(5, 5),
                Some(recall.ar_without_vsd),
                Some(recall.median_rotation_deg),
                Some(recall.median_translation_m),
            ],
        };
        let [add, proj5, deg5_cm5, ar_without_vsd, median_rotation_deg, median_translation_m] =
            bootstrap.intervals(images, figures);
        let ok = images.iter().map(|seen| seen.iter().filter(|one| one.record.is_ok()).copied().collect());
        let ok: Vec<Vec<_>> = ok.filter(|seen: &Vec<_>| !seen.is_empty()).collect();
        let wrong =
            |seen: &[Seen<'_>]| Some(seen.iter().filter(|one| !one.view.is_right()).count() as f64 / seen.len() as f64);
        let share = |interval: Option<Interval>| interval.map(|interval| widened(interval, images.len()));
        Self {
            add: share(add),
            proj5: share(proj5),
            deg5_cm5: share(deg5_cm5),
            ar_without_vsd,
            ok_wrong: bootstrap.interval(&ok, wrong).map(|interval| widened(interval, ok.len())),
            median_rotation_deg,
            median_translation_m,
        }
    }
}

/// Where all views are alike, so is every draw, however few they are. Then Wilson's interval of so many images (Journal of the American
/// Statistical Association, 1927) says what they leave open.
fn widened(interval: Interval, images: usize) -> Interval {
    const SQUARED_QUANTILE: f64 = 3.841;
    let n = images as f64;
    match interval {
        Interval { low, .. } if low >= 1.0 => Interval { low: n / (n + SQUARED_QUANTILE), high: 1.0 },
        Interval { high, .. } if high <= 0.0 => Interval { low: 0.0, high: SQUARED_QUANTILE / (n + SQUARED_QUANTILE) },
        other => other,
    }
}
