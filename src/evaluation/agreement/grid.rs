use std::collections::HashMap;

use nalgebra::Vector3;

/// Points sorted into cubes, so that those near a point are found without looking at all.
pub(super) struct Grid {
    side_m: f64,
    cells: HashMap<[u64; 3], Vec<usize>>,
}

impl Grid {
    pub(super) fn new(side_m: f64) -> Self {
        Self { side_m, cells: HashMap::new() }
    }

    pub(super) fn insert(&mut self, point: &Vector3<f64>, index: usize) {
        let key = self.key(point, [0.0; 3]);
        self.cells.entry(key).or_default().push(index);
    }

    /// All within `side_m` of a point, and some others.
    pub(super) fn near(&self, point: &Vector3<f64>) -> impl Iterator<Item = usize> {
        around().filter_map(|step| self.cells.get(&self.key(point, step))).flatten().copied()
    }

    /// Forgets those about a point that are not wanted any more.
    pub(super) fn retain_near(&mut self, point: &Vector3<f64>, wanted: impl Fn(usize) -> bool) {
        for step in around() {
            let key = self.key(point, step);
            if let Some(cell) = self.cells.get_mut(&key) {
                cell.retain(|index| wanted(*index));
            }
        }
    }

    /// The bits of whole numbers, which no cast can cut off.
    fn key(&self, point: &Vector3<f64>, step: [f64; 3]) -> [u64; 3] {
        // Adding zero makes -0 and 0 one.
        std::array::from_fn(|axis| ((point[axis] / self.side_m).floor() + step[axis] + 0.0).to_bits())
    }
}

/// The cube itself and its 26 neighbours.
fn around() -> impl Iterator<Item = [f64; 3]> {
    let steps = [-1.0, 0.0, 1.0];
    steps.into_iter().flat_map(move |x| steps.into_iter().flat_map(move |y| steps.into_iter().map(move |z| [x, y, z])))
}
