use std::collections::BTreeSet;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::file::{Invalid, ManifestError, check_name, read_manifest};
use super::input::{Channels, ElementType, Layout, PixelFormat};

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
    /// What boxes are measured in.
    #[serde(default)]
    pub coordinates: Coordinates,
    /// Detections below this score are dropped.
    pub score_threshold: f64,
    /// Of two boxes of one class with a larger intersection over union the weaker is dropped.
    #[serde(default = "usual_iou_threshold")]
    pub iou_threshold: f64,
    /// Most boxes that the network itself returns, of all classes together. An answer says when there were so many.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_detections: Option<usize>,
    /// Most boxes of one class that the network itself returns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_detections_per_class: Option<usize>,
    /// Where the network comes from; for people.
    #[serde(default)]
    pub training: serde_json::Value,
}

fn usual_iou_threshold() -> f64 {
    0.5
}

/// What a detector's output means. Stated, never guessed.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DetectorFormat {
    /// Outputs `boxes` (x1, y1, x2, y2), `labels` and `scores`, N of each; RT-DETR and D-FINE, too.
    Torchvision,
    /// `[1, N, 5 + C]`: centre x, centre y, width, height, objectness, one score for each class (`YOLOv3` by Ultralytics, too).
    Yolov5,
    /// `[1, 4 + C, N]`: centre x, centre y, width, height, one score for each class (v8 to v12).
    Yolov8,
    /// Non-maximum suppression inside: `[1, N, 6]` rows of x1, y1, x2, y2, score, class.
    End2end,
    /// Non-maximum suppression inside, as `YOLOv7` exports it: `[N, 7]` rows of image, x1, y1, x2, y2, class, score.
    Yolov7End2end,
    /// The four outputs of `TensorRT`'s `EfficientNMS`, in this order, whatever their names: number of boxes `[1, 1]`, boxes
    /// `[1, N, 4]` (x1, y1, x2, y2), scores `[1, N]` and classes `[1, N]`.
    EfficientNms,
}

/// What boxes are measured in.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Coordinates {
    /// Pixels of the network's input.
    #[default]
    Pixels,
    /// Widths and heights of the network's input: 0..1.
    Normalised,
}

/// One image, made to fit.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorInput {
    pub layout: Layout,
    pub dtype: ElementType,
    #[serde(default)]
    pub channels: Channels,
    pub width: u32,
    pub height: u32,
    /// Grey value of the filling.
    pub fill: u8,
    /// Where the image lies in the input.
    #[serde(default)]
    pub placement: Placement,
    /// Mean of each channel, of pixels in 0..1: for floats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<[f32; 3]>,
    /// Standard deviation of each channel, of pixels in 0..1: for floats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<[f32; 3]>,
    /// Name of a second input, 64-bit integers `[1, 2]`, for the size of the image (`orig_target_sizes`). It is given `width`
    /// and `height`, so that boxes come in pixels of this input.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size_input: Option<String>,
}

/// Where an image lies in a network's input.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// Its aspect kept, the rest filled.
    #[default]
    TopLeft,
    /// The same in the middle.
    #[serde(alias = "letterbox")]
    Centre,
    /// Over the whole input.
    Stretch,
}

impl DetectorInput {
    #[must_use]
    pub fn pixels(&self) -> PixelFormat {
        let Self { layout, dtype, channels, mean, std, .. } = *self;
        PixelFormat { layout, dtype, channels, mean, std }
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
        let mut known = BTreeSet::new();
        for name in names {
            check_name(name).map_err(|problem| ("labels", problem))?;
            if !known.insert(name) {
                return Err(("labels", format!("has {name:?} twice")));
            }
        }
        for (field, share) in [("score_threshold", self.score_threshold), ("iou_threshold", self.iou_threshold)] {
            if !(0.0..1.0).contains(&share) {
                return Err((field, format!("is {share}; it must be at least 0 and less than 1")));
            }
        }
        for (field, most) in
            [("max_detections", self.max_detections), ("max_detections_per_class", self.max_detections_per_class)]
        {
            if most == Some(0) {
                return Err((field, "is 0; it must be at least 1, or left out".into()));
            }
        }
        for (field, side) in [("input.width", self.input.width), ("input.height", self.input.height)] {
            if !(32..=2048).contains(&side) {
                return Err((field, format!("is {side}; it must be between 32 and 2048")));
            }
        }
        if self.input.size_input.is_some() && self.coordinates == Coordinates::Normalised {
            let problem = "is \"normalised\", but 'input.size_input' gives the network a size: its boxes are in pixels";
            return Err(("coordinates", problem.into()));
        }
        self.input.pixels().check()
    }
}
