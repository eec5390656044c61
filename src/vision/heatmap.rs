use nalgebra::{Matrix2, Vector2};

/// Half side of the window that a keypoint's mean is taken in, pixels of the network's input.
const WINDOW_PX: f64 = 11.0;

/// A keypoint as a heatmap shows it, in pixels of the network's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    pub position: Vector2<f64>,
    /// Second moment of the whole map about the position, px².
    pub covariance: Matrix2<f64>,
    /// Probability mass in the window, 0..1.
    pub mass: f64,
}

/// The keypoint of one square heatmap of logits, `side` x `side` cells over an input of `input_px` pixels: softmax, then
/// the mean in a window about the highest cell (over the whole map it would lie between two peaks). The same as the
/// trainer's `heatmap.py`, whose nets do this inside their graphs.
#[must_use]
pub fn find_peak(logits: &[f32], side: usize, input_px: f64) -> Peak {
    let stride = input_px / side as f64;
    let centre = |index: usize| {
        let cell = Vector2::new((index % side) as f64, (index / side) as f64);
        cell.add_scalar(0.5) * stride - Vector2::repeat(0.5)
    };
    let (highest, top) = logits
        .iter()
        .enumerate()
        .fold((0, f32::NEG_INFINITY), |best, (index, logit)| if *logit > best.1 { (index, *logit) } else { best });
    let weights: Vec<f64> = logits.iter().map(|logit| f64::from(logit - top).exp()).collect();
    let total: f64 = weights.iter().sum();
    let near = |index: usize| (centre(index) - centre(highest)).amax() < WINDOW_PX;
    let (mut mass, mut first_moment) = (0.0, Vector2::zeros());
    for (index, weight) in weights.iter().enumerate().filter(|(index, _)| near(*index)) {
        mass += weight;
        first_moment += centre(index) * *weight;
    }
    let position = first_moment / mass;
    let covariance = weights.iter().enumerate().fold(Matrix2::zeros(), |sum, (index, weight)| {
        let offset = centre(index) - position;
        sum + offset * offset.transpose() * *weight
    }) / total;
    Peak { position, covariance, mass: mass / total }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Case {
        side: usize,
        input_px: f64,
        logits: Vec<f32>,
        keypoint: [f64; 2],
        covariance: [[f64; 2]; 2],
        peak: f64,
    }

    /// The trainer (`training/posed_train/heatmap.py`) is tested against the same file.
    #[test]
    fn peaks_are_the_trainers() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/heatmaps.json");
        let cases: Vec<Case> = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        assert!(cases.len() >= 3);
        for case in cases {
            let found = find_peak(&case.logits, case.side, case.input_px);
            assert!((found.position - Vector2::from(case.keypoint)).amax() < 1e-3, "{found:?}");
            let covariance = Matrix2::from(case.covariance);
            assert!((found.covariance - covariance).amax() < 1e-3 * covariance.amax(), "{found:?}");
            assert!((found.mass - case.peak).abs() < 1e-4, "{found:?}");
        }
    }
}
