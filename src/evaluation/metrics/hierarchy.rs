use nalgebra::SVector;

/// So many points in a leaf cost about as much as the boxes above them.
const LEAF: usize = 16;

/// Sorts points so that each half, quarter, eighth (and so on) of them is a compact region: each part is halved at the median
/// along its widest side.
pub(super) fn spatial_order<const D: usize>(points: &mut [SVector<f64, D>]) {
    let depth = points.len().next_power_of_two().ilog2();
    sort_parts(points, 0, 1 << depth, points.len(), depth);
}

/// Sorts the points of the parts `first..last` of `2^depth` parts of all points.
fn sort_parts<const D: usize>(points: &mut [SVector<f64, D>], first: usize, last: usize, all: usize, depth: u32) {
    if points.len() < 2 {
        return;
    }
    let [low, high] = bounds(points);
    let axis = (high - low).imax();
    let middle = usize::midpoint(first, last);
    let (start, split) = ((first * all) >> depth, (middle * all) >> depth);
    points.select_nth_unstable_by(split - start, |a, b| a[axis].total_cmp(&b[axis]));
    let (before, after) = points.split_at_mut(split - start);
    sort_parts(before, first, middle, all, depth);
    sort_parts(after, middle, last, all, depth);
}

/// Halvings of so many points until each part is a leaf.
fn depth(points: usize) -> u32 {
    points.div_ceil(LEAF).next_power_of_two().ilog2()
}

/// Points in [`spatial_order`] with boxes around each half, quarter and so on of them. Finds the nearest point, exactly.
///
/// A k-d tree whose order is made once: points that move, as projections do from view to view, need only new boxes, and those
/// take one pass.
#[derive(Clone, Debug)]
pub(super) struct Hierarchy<const D: usize> {
    points: Vec<SVector<f64, D>>,
    /// Smallest and largest corner; the root is box 1, the halves of box k are boxes 2k and 2k + 1.
    boxes: Vec<[SVector<f64, D>; 2]>,
    depth: u32,
}

impl<const D: usize> Hierarchy<D> {
    /// Of points in any order, which decides the speed alone.
    pub(super) fn new(points: Vec<SVector<f64, D>>) -> Self {
        let depth = depth(points.len());
        let leaves = 1 << depth;
        let mut boxes = vec![bounds(&[]); 2 * leaves];
        for leaf in 0..leaves {
            boxes[leaves + leaf] = bounds(&points[part(leaf, points.len(), depth)]);
        }
        for node in (1..leaves).rev() {
            let ([low, high], [other_low, other_high]) = (boxes[2 * node], boxes[2 * node + 1]);
            boxes[node] = [low.inf(&other_low), high.sup(&other_high)];
        }
        Self { points, boxes, depth }
    }

    pub(super) fn points(&self) -> &[SVector<f64, D>] {
        &self.points
    }

    /// Smallest and largest coordinates.
    pub(super) fn bounds(&self) -> [SVector<f64, D>; 2] {
        self.boxes[1]
    }

    /// Distance from the nearest point; infinite if there are none.
    pub(super) fn distance(&self, from: &SVector<f64, D>) -> f64 {
        let leaves = 1 << self.depth;
        let to_box = |node: usize| {
            let [low, high] = &self.boxes[node];
            (from - from.sup(low).inf(high)).norm_squared()
        };
        let mut best = f64::INFINITY;
        let mut pending = Vec::with_capacity(2 * self.depth as usize + 1);
        pending.push((1, to_box(1)));
        while let Some((node, bound)) = pending.pop() {
            if bound >= best {
                continue;
            }
            if node >= leaves {
                let leaf = &self.points[part(node - leaves, self.points.len(), self.depth)];
                best = leaf.iter().map(|point| (from - point).norm_squared()).fold(best, f64::min);
                continue;
            }
            let mut halves = [2 * node, 2 * node + 1].map(|half| (half, to_box(half)));
            // The nearer half is looked at first.
            halves.sort_by(|a, b| b.1.total_cmp(&a.1));
            pending.extend(halves);
        }
        best.sqrt()
    }
}

/// The places of one of `2^depth` equal parts.
pub(super) fn part(index: usize, all: usize, depth: u32) -> std::ops::Range<usize> {
    (index * all) >> depth..((index + 1) * all) >> depth
}

fn bounds<const D: usize>(points: &[SVector<f64, D>]) -> [SVector<f64, D>; 2] {
    let nothing = [SVector::repeat(f64::INFINITY), SVector::repeat(f64::NEG_INFINITY)];
    points.iter().fold(nothing, |[low, high], point| [low.inf(point), high.sup(point)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_point_is_found(
            // On a coarse grid many points share a coordinate, or all.
            grid in prop::collection::vec(prop::array::uniform3(-3..3i32), 1..300),
            from in prop::array::uniform3(-9.0..9.0f64),
            sorted: bool,
        ) {
            let mut points: Vec<_> = grid.into_iter().map(|p| Vector3::from(p.map(f64::from))).collect();
            let from = Vector3::from(from);
            let nearest = points.iter().map(|p| (p - from).norm()).fold(f64::INFINITY, f64::min);
            if sorted {
                spatial_order(&mut points);
            }
            prop_assert!((Hierarchy::new(points).distance(&from) - nearest).abs() < 1e-12);
        }

        #[test]
        fn sorting_keeps_the_points(mut points in prop::collection::vec(-9..9i32, 0..200)) {
            let mut sorted: Vec<_> = points.iter().map(|x| nalgebra::Vector1::new(f64::from(*x))).collect();
            spatial_order(&mut sorted);
            sorted.sort_by(|a, b| a.x.total_cmp(&b.x));
            points.sort_unstable();
            let before: Vec<_> = points.into_iter().map(|x| nalgebra::Vector1::new(f64::from(x))).collect();
            prop_assert_eq!(sorted, before);
        }
    }

    #[test]
    fn parts_of_sorted_points_are_compact() {
        let side = 32;
        let mut points: Vec<_> =
            (0..side * side).map(|k| Vector3::new(f64::from(k % side), f64::from(k / side), 0.0)).collect();
        spatial_order(&mut points);
        for quarter in 0..4 {
            let [low, high] = bounds(&points[part(quarter, points.len(), 2)]);
            assert!((high - low).max() < f64::from(side) / 2.0, "{low} {high}");
        }
    }
}
