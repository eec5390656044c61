use std::iter::Sum;

use serde::Serialize;

use super::statistics::share;
use crate::vision::BoundingBox;

/// A box that a detector found in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundBox {
    /// Which object it is said to be, in any numbering.
    pub object: usize,
    /// Of two boxes, the one with the larger score takes its true box first.
    pub score: f64,
    /// Pixels.
    pub bounding_box: BoundingBox,
}

/// A box of an object that is in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueBox {
    /// In the same numbering.
    pub object: usize,
    /// Pixels.
    pub bounding_box: BoundingBox,
    /// Not to be found, as one that is hidden too much: neither finding nor missing it counts.
    pub ignored: bool,
}

/// Which boxes of one image belong together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Matching {
    /// For each found box the place of its true one, ignored or not.
    pub of_found: Vec<Option<usize>>,
    /// Found boxes of a true one that counts.
    pub true_positives: usize,
    /// Found boxes without a true one.
    pub false_positives: usize,
    /// True boxes that count, and that no box was found of.
    pub misses: usize,
}

impl Matching {
    /// Matches as COCO does (`pycocotools`, `COCOeval.evaluateImg`): in the order of their scores, each found box takes the free
    /// true box of its object with the largest intersection over union, if it is at least `overlap`; one that is ignored only if
    /// no other is left.
    #[must_use]
    pub fn new(found: &[FoundBox], truths: &[TrueBox], overlap: f64) -> Self {
        let mut order: Vec<_> = (0..found.len()).collect();
        // A score that is not a number comes last.
        let key = |place: usize| if found[place].score.is_nan() { f64::NEG_INFINITY } else { found[place].score };
        order.sort_by(|a, b| key(*b).total_cmp(&key(*a)));
        let mut free = vec![true; truths.len()];
        let mut of_found = vec![None; found.len()];
        for place in order {
            let FoundBox { object, bounding_box, .. } = &found[place];
            let shared = |truth: usize| truths[truth].bounding_box.overlap(bounding_box);
            let may = |truth: &usize| free[*truth] && truths[*truth].object == *object && shared(*truth) >= overlap;
            let best = (0..truths.len()).filter(may).max_by(|a, b| {
                // Of equal ones the first.
                let counts = |truth: usize| !truths[truth].ignored;
                counts(*a).cmp(&counts(*b)).then(shared(*a).total_cmp(&shared(*b))).then(b.cmp(a))
            });
            if let Some(best) = best {
                free[best] = false;
            }
            of_found[place] = best;
        }
        let counted = |truth: &usize| !truths[*truth].ignored;
        Self {
            true_positives: of_found.iter().flatten().filter(|truth| counted(truth)).count(),
            false_positives: of_found.iter().filter(|truth| truth.is_none()).count(),
            misses: (0..truths.len()).filter(counted).filter(|truth| free[*truth]).count(),
            of_found,
        }
    }
}

/// How well a detector finds objects, over images.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DetectionScore {
    /// Images, with an object or without.
    pub images: usize,
    /// True boxes that were found.
    pub true_positives: usize,
    /// Found boxes without a true one.
    pub false_positives: usize,
    /// True boxes that were not found.
    pub misses: usize,
    /// Share of true boxes that were found; `None` if there are none.
    pub recall: Option<f64>,
    /// Share of found boxes that are true; `None` if none was found.
    pub precision: Option<f64>,
    /// Found boxes without a true one for each image; `None` without images.
    pub false_boxes_per_image: Option<f64>,
}

impl<'a> Sum<&'a Matching> for DetectionScore {
    fn sum<I: Iterator<Item = &'a Matching>>(matchings: I) -> Self {
        let mut all = Self::default();
        for one in matchings {
            all.images += 1;
            all.true_positives += one.true_positives;
            all.false_positives += one.false_positives;
            all.misses += one.misses;
        }
        all.recall = share(all.true_positives, all.true_positives + all.misses);
        all.precision = share(all.true_positives, all.true_positives + all.false_positives);
        all.false_boxes_per_image = share(all.false_positives, all.images);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> BoundingBox {
        BoundingBox { x, y: 0.0, width: 10.0, height: 10.0 }
    }

    fn found(object: usize, score: f64, x: f64) -> FoundBox {
        FoundBox { object, score, bounding_box: at(x) }
    }

    fn truth(object: usize, x: f64, ignored: bool) -> TrueBox {
        TrueBox { object, bounding_box: at(x), ignored }
    }

    fn counts(matching: &Matching) -> [usize; 3] {
        [matching.true_positives, matching.false_positives, matching.misses]
    }

    #[test]
    fn the_better_score_takes_the_true_box() {
        let matching = Matching::new(&[found(0, 0.3, 0.0), found(0, 0.9, 2.0)], &[truth(0, 0.0, false)], 0.5);
        assert_eq!((counts(&matching), &matching.of_found[..]), ([1, 1, 0], &[None, Some(0)][..]));
        let unsure = Matching::new(&[found(0, f64::NAN, 0.0), found(0, 0.1, 2.0)], &[truth(0, 0.0, false)], 0.5);
        assert_eq!(unsure.of_found, [None, Some(0)]);
    }

    #[test]
    fn the_largest_overlap_is_taken_and_only_of_the_same_object() {
        let truths = [truth(0, 3.0, false), truth(0, 1.0, false), truth(1, 0.0, false)];
        let matching = Matching::new(&[found(0, 0.9, 0.0)], &truths, 0.5);
        assert_eq!((counts(&matching), &matching.of_found[..]), ([1, 0, 2], &[Some(1)][..]));
    }

    #[test]
    fn the_overlap_may_be_the_least() {
        // Shifted by a third of the width: 2/3 over 4/3.
        let third = BoundingBox { x: 10.0, y: 0.0, width: 30.0, height: 10.0 };
        let box_of = |bounding_box| FoundBox { object: 0, score: 1.0, bounding_box };
        let truths = [TrueBox { object: 0, bounding_box: BoundingBox { x: 0.0, ..third }, ignored: false }];
        assert_eq!(counts(&Matching::new(&[box_of(third)], &truths, 0.5)), [1, 0, 0]);
        let further = BoundingBox { x: 10.1, ..third };
        assert_eq!(counts(&Matching::new(&[box_of(further)], &truths, 0.5)), [0, 1, 1]);
    }

    #[test]
    fn ignored_boxes_count_neither_way() {
        let truths = [truth(0, 0.0, true), truth(0, 50.0, true)];
        let matching = Matching::new(&[found(0, 0.9, 0.0)], &truths, 0.5);
        assert_eq!((counts(&matching), &matching.of_found[..]), ([0, 0, 0], &[Some(0)][..]));
        // One that counts is preferred even if the ignored one is nearer.
        let truths = [truth(0, 0.0, true), truth(0, 3.0, false)];
        assert_eq!(Matching::new(&[found(0, 0.9, 0.0)], &truths, 0.5).of_found, [Some(1)]);
    }

    #[test]
    fn images_are_added_up() {
        let truths = [truth(0, 0.0, false), truth(0, 50.0, false)];
        let good = Matching::new(&[found(0, 0.9, 0.0), found(0, 0.8, 50.0)], &truths, 0.5);
        let bad = Matching::new(&[found(0, 0.9, 100.0)], &truths[..1], 0.5);
        let score: DetectionScore = [&good, &bad].into_iter().sum();
        assert_eq!((score.images, score.false_boxes_per_image), (2, Some(0.5)));
        assert_eq!((score.recall, score.precision), (Some(2.0 / 3.0), Some(2.0 / 3.0)));
        let nothing: DetectionScore = [].into_iter().sum();
        assert_eq!((nothing.recall, nothing.precision, nothing.false_boxes_per_image), (None, None, None));
    }
}
