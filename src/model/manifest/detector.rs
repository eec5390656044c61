use std::path::Path;

use serde::{Deserialize, Serialize};

use super::file::{Invalid, ManifestError, check_name, read_manifest};
use super::input::{self, ElementType, Layout, Normalisation};

/// `models/detector/detector.json`.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorManifest {
    pub format: DetectorFormat,
    /// SHA-256 of `detector.onnx`, hexadecimal.
    pub model_sha256: String,
    pub input: DetectorInput,
    /// Object name of each class, by class index; null for a class that is no object here, such as a background.
    pub labels: Vec<Option<String>>,
    /// Detections below this score are dropped.
    pub score_threshold: f64,
    /// Of two boxes of one class with a larger intersection over union the weaker is dropped.
    #[serde(default = "usual_iou_threshold")]
    pub iou_threshold: f64,
    /// Where the network comes from; for people.
    #[serde(default)]
    pub training: serde_json::Value,
}

fn usual_iou_threshold() -> f64 {
    0.5
}

/// What the rows of a detector's output mean. Boxes are in pixels of the network's input. Stated, never guessed.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DetectorFormat {
    /// Outputs `boxes [N, 4]` (x1, y1, x2, y2), `labels [N]`, `scores [N]`.
    Torchvision,
    /// `[1, N, 5 + C]`: centre x, centre y, width, height, objectness, one score for each class (`YOLOv3` by Ultralytics, too).
    Yolov5,
    /// `[1, 4 + C, N]`: centre x, centre y, width, height, one score for each class (v8 to v12).
    Yolov8,
    /// Non-maximum suppression inside: `[1, N, 6]` rows of x1, y1, x2, y2, score, class.
    End2end,
}

/// One letterboxed RGB image.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorInput {
    pub layout: Layout,
    pub dtype: ElementType,
    pub width: u32,
    pub height: u32,
    /// Grey value of the filling.
    pub fill: u8,
    /// Where the fitted image lies in the input.
    #[serde(default)]
    pub placement: Placement,
    /// Mean of each channel, of pixels in 0..1: for floats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of each channel, of pixels in 0..1: for floats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<[f32; 3]>,
}

/// Where a letterboxed image lies.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    #[default]
    TopLeft,
    Centre,
}

impl DetectorInput {
    #[must_use]
    pub fn normalisation(&self) -> Normalisation {
        Normalisation::new(self.mean, self.std)
    }
}

impl DetectorManifest {
    /// Reads and checks `detector.json`.
    ///
    /// # Errors
    /// [`ManifestError`] names the file and the field.
    pub fn read(path: &Path) -> Result<Self, ManifestError> {
        read_manifest(path, Self::validate)
    }

    fn validate(&self) -> Result<(), Invalid> {
        let names: Vec<&String> = self.labels.iter().flatten().collect();
        if names.is_empty() {
            return Err(("labels", "has no object; it must name the object of each class".into()));
        }
        for (index, name) in names.iter().enumerate() {
            check_name(name).map_err(|problem| ("labels", problem))?;
            if names[..index].contains(name) {
                return Err(("labels", format!("has {name:?} twice")));
            }
        }
        for (field, share) in [("score_threshold", self.score_threshold), ("iou_threshold", self.iou_threshold)] {
            if !(0.0..1.0).contains(&share) {
                return Err((field, format!("is {share}; it must be at least 0 and less than 1")));
            }
        }
        for (field, side) in [("input.width", self.input.width), ("input.height", self.input.height)] {
            if !(32..=2048).contains(&side) {
                return Err((field, format!("is {side}; it must be between 32 and 2048")));
            }
        }
        input::check(self.input.layout, self.input.dtype, self.input.mean, self.input.std)
    }
}
