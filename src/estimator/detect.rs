//! Detector outputs to boxes in image pixels.

use std::time::Instant;

use fast_image_resize::Resizer;
use image::RgbImage;
use nalgebra::Vector2;

use super::answer::{Detection, EstimateError};
use crate::model::{DetectorFormat, DetectorManifest, ElementType, Input, Network, Outputs, Placement, RuntimeError};
use crate::vision::{BoundingBox, Letterbox, letterbox, to_planes};

/// More objects than this in one image are dropped, weakest first.
pub(super) const MAX_DETECTIONS: usize = 32;
/// Boxes of different classes with a larger intersection over union are one object.
const SAME_PLACE_OVERLAP: f64 = 0.7;
/// More boxes than this above the threshold mean a broken network; suppression takes quadratic time.
const MAX_CANDIDATES: usize = 1024;

/// A box in edge coordinates of the network's input.
struct Candidate {
    corners: [f64; 4],
    score: f64,
    class: usize,
}

/// Runs the detector on one image; the strongest detections first.
pub(super) fn detect(
    manifest: &DetectorManifest,
    network: &mut dyn Network,
    resizer: &mut Resizer,
    image: &RgbImage,
) -> Result<(Vec<Detection>, std::time::Duration), EstimateError> {
    let start = Instant::now();
    let input = &manifest.input;
    let to = Letterbox {
        width: input.width,
        height: input.height,
        fill: input.fill,
        centred: input.placement == Placement::Centre,
    };
    let boxed = letterbox(resizer, image, to)?;
    let (width, height) = (input.width as usize, input.height as usize);
    let outputs = match input.dtype {
        ElementType::Uint8 => network.run(Input::Bytes { shape: [1, height, width, 3], values: &boxed.rgb })?,
        ElementType::Float32 => {
            let normalisation = input.normalisation();
            let planes = to_planes(&boxed.rgb, width * height, normalisation.mean, normalisation.std);
            network.run(Input::Floats { shape: [1, 3, height, width], values: &planes })?
        }
    };
    let mut candidates = candidates(manifest, &outputs)?;
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    candidates.truncate(MAX_CANDIDATES);
    let image_from_input = boxed.crop_from_image.inverse();
    let image_size = Vector2::new(f64::from(image.width()), f64::from(image.height()));
    let detections = candidates.iter().filter_map(|candidate| {
        let [x1, y1, x2, y2] = candidate.corners;
        // Edges to pixel centres and back: the affine maps centres.
        let edge = |x: f64, y: f64| image_from_input.apply(&Vector2::new(x - 0.5, y - 0.5)).add_scalar(0.5);
        let (first, last) = (edge(x1, y1).sup(&Vector2::zeros()), edge(x2, y2).inf(&image_size));
        let size = last - first;
        (size.min() >= 2.0).then_some(Detection {
            object: candidate.class,
            bounding_box: BoundingBox { x: first.x, y: first.y, width: size.x, height: size.y },
            score: candidate.score.min(1.0),
        })
    });
    let kept = suppress(detections, manifest.iou_threshold);
    Ok((kept, start.elapsed()))
}

/// Drops what overlaps a stronger detection: of the same class beyond the manifest's threshold, of another class only
/// where both claim one place.
fn suppress(strongest_first: impl Iterator<Item = Detection>, iou_threshold: f64) -> Vec<Detection> {
    let mut kept: Vec<Detection> = Vec::new();
    for detection in strongest_first {
        let taken = kept.iter().any(|k| {
            let limit = if k.object == detection.object { iou_threshold } else { SAME_PLACE_OVERLAP };
            k.bounding_box.overlap(&detection.bounding_box) > limit
        });
        if !taken {
            kept.push(detection);
        }
        if kept.len() == MAX_DETECTIONS {
            break;
        }
    }
    kept
}

/// The boxes of known objects above the score threshold.
fn candidates(manifest: &DetectorManifest, outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    let classes = manifest.labels.len();
    let rows = match manifest.format {
        DetectorFormat::Torchvision => torchvision(outputs)?,
        DetectorFormat::Yolov5 => yolov5(outputs, classes)?,
        DetectorFormat::Yolov8 => yolov8(outputs, classes)?,
        DetectorFormat::End2end => end2end(outputs)?,
    };
    let known = |class: usize| manifest.labels.get(class).is_some_and(Option::is_some);
    Ok(rows.into_iter().filter(|row| row.score >= manifest.score_threshold && known(row.class)).collect())
}

fn torchvision(outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    let [boxes, labels, scores] = ["boxes", "labels", "scores"].map(|name| outputs.named(name));
    let (boxes, labels, scores) = (boxes?, labels?, scores?);
    let count = scores.values.len();
    for (tensor, expected) in [(boxes, 4 * count), (labels, count)] {
        if tensor.values.len() != expected {
            let problem = format!("has shape {:?} beside {count} scores", tensor.shape);
            return Err(outputs.error(&tensor.name, problem));
        }
    }
    let corners = boxes.values.chunks_exact(4).map(|row| [0, 1, 2, 3].map(|k| f64::from(row[k])));
    let rows = corners.zip(&labels.values).zip(&scores.values);
    Ok(rows.filter_map(|((corners, label), score)| candidate(corners, *score, *label)).collect())
}

fn end2end(outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    let output = outputs.first()?;
    if output.shape.len() != 3 || output.shape[2] != 6 {
        return Err(outputs.error(&output.name, format!("has shape {:?}, expected [1, N, 6]", output.shape)));
    }
    let rows = output.values.chunks_exact(6);
    Ok(rows.filter_map(|row| candidate([0, 1, 2, 3].map(|k| f64::from(row[k])), row[4], row[5])).collect())
}

fn yolov5(outputs: &Outputs, classes: usize) -> Result<Vec<Candidate>, RuntimeError> {
    let output = outputs.first()?;
    if output.shape.len() != 3 || output.shape[2] != 5 + classes {
        let problem = format!("has shape {:?}, expected [1, N, {}] for {classes} labels", output.shape, 5 + classes);
        return Err(outputs.error(&output.name, problem));
    }
    let rows = output.values.chunks_exact(5 + classes);
    Ok(rows.map(|row| from_centre([0, 1, 2, 3].map(|k| row[k]), row[4], row[5..].iter().copied())).collect())
}

fn yolov8(outputs: &Outputs, classes: usize) -> Result<Vec<Candidate>, RuntimeError> {
    let output = outputs.first()?;
    if output.shape.len() != 3 || output.shape[1] != 4 + classes {
        let problem = format!("has shape {:?}, expected [1, {}, N] for {classes} labels", output.shape, 4 + classes);
        return Err(outputs.error(&output.name, problem));
    }
    let count = output.shape[2];
    let value = |field: usize, row: usize| output.values[field * count + row];
    let row = |row: usize| {
        from_centre([0, 1, 2, 3].map(|k| value(k, row)), 1.0, (0..classes).map(move |class| value(4 + class, row)))
    };
    Ok((0..count).map(row).collect())
}

/// A box given by its centre and size, of its likeliest class.
fn from_centre(centre_and_size: [f32; 4], objectness: f32, scores: impl Iterator<Item = f32>) -> Candidate {
    let [x, y, width, height] = centre_and_size.map(f64::from);
    let best = scores.enumerate().fold((0, f32::NEG_INFINITY), |best, new| if new.1 > best.1 { new } else { best });
    let corners = [x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0];
    Candidate { corners, score: f64::from(objectness) * f64::from(best.1), class: best.0 }
}

/// `None` for a class that is no whole number.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be a small whole number")]
fn candidate(corners: [f64; 4], score: f32, class: f32) -> Option<Candidate> {
    let whole = class.round();
    let usable = (0.0..1e6).contains(&whole) && (class - whole).abs() < 1e-3;
    usable.then_some(Candidate { corners, score: f64::from(score), class: whole as usize })
}
