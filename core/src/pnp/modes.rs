//! The best few poses that are not one pose.

use crate::geometry::Pose;

/// Poses closer than 15 degrees are one mode. As the squared Frobenius distance `8 sin²(angle / 2)` of their rotations,
/// which costs no arc sine.
const MODE_SEPARATION: f64 = 8.0 * 0.130_526_192 * 0.130_526_192;

/// Something with a pose and a cost.
pub(super) trait Candidate: Copy {
    fn pose(&self) -> &Pose;
    fn cost(&self) -> f64;
}

/// The best `K` candidates that are distinct modes, best first.
pub(super) struct Ranking<T, const K: usize> {
    entries: [Option<T>; K],
}

impl<T: Candidate, const K: usize> Default for Ranking<T, K> {
    fn default() -> Self {
        Self { entries: [None; K] }
    }
}

impl<T: Candidate, const K: usize> Ranking<T, K> {
    pub(super) fn iter(&self) -> impl Iterator<Item = &T> {
        self.entries.iter().flatten()
    }

    pub(super) fn best(&self) -> Option<&T> {
        self.entries[0].as_ref()
    }

    /// A candidate must cost less than this to enter.
    pub(super) fn worst(&self) -> f64 {
        self.entries[K - 1].as_ref().map_or(f64::INFINITY, T::cost)
    }

    pub(super) fn insert(&mut self, candidate: T) {
        let same_mode = |entry: &T| {
            let apart = entry.pose().rotation().matrix() - candidate.pose().rotation().matrix();
            apart.norm_squared() < MODE_SEPARATION
        };
        if self.iter().any(|entry| entry.cost() <= candidate.cost() && same_mode(entry)) {
            return;
        }
        let mut kept = [None; K];
        let mut next = 0;
        let mut pending = Some(candidate);
        for entry in self.entries.into_iter().flatten() {
            if next < K && pending.is_some_and(|new| new.cost() < entry.cost()) {
                kept[next] = pending.take();
                next += 1;
            }
            if next < K && !same_mode(&entry) {
                kept[next] = Some(entry);
                next += 1;
            }
        }
        if next < K && pending.is_some() {
            kept[next] = pending;
        }
        self.entries = kept;
    }
}
