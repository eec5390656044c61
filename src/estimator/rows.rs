//! What a detector's output says, whatever its format.

use crate::model::{Coordinates, DetectorFormat, DetectorManifest, Output, Outputs, RuntimeError};

/// A box in edge coordinates of the network's input.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub corners: [f64; 4],
    pub score: f64,
    pub class: usize,
}

/// The boxes of known objects above the score threshold.
pub(super) struct Candidates {
    pub boxes: Vec<Candidate>,
    /// Whether the network may have seen more of a class with the least score asked for, but returns no more boxes.
    pub cut: Vec<bool>,
}

/// No class that anybody asks for.
const NO_CLASS: usize = usize::MAX;

/// The boxes that count. Others are not looked at, whatever is in them: padding may be anything.
pub(super) fn candidates(
    manifest: &DetectorManifest,
    outputs: &Outputs,
    least_score: f64,
) -> Result<Candidates, RuntimeError> {
    let classes = manifest.labels.len();
    let mut boxes = match manifest.format {
        DetectorFormat::Torchvision => torchvision(outputs)?,
        DetectorFormat::Yolov5 => yolov5(outputs, classes)?,
        DetectorFormat::Yolov8 => yolov8(outputs, classes)?,
        DetectorFormat::End2end => end2end(outputs)?,
        DetectorFormat::Yolov7End2end => yolov7(outputs)?,
        DetectorFormat::EfficientNms => efficient_nms(outputs)?,
    };
    if !boxes.is_empty() && !boxes.iter().any(|found| found.score.is_finite()) {
        // Not an image without objects: a network that has overflowed.
        return Err(outputs.failed(format!("none of its {} scores is a finite number", boxes.len())));
    }
    boxes.retain(|found| found.score >= manifest.score_threshold);
    let full = |most: Option<usize>, count: usize| most.is_some_and(|most| count >= most);
    let asked = || boxes.iter().filter(|found| found.score >= least_score);
    let full_in_all = full(manifest.max_detections, asked().count());
    let of_class = |class: usize| asked().filter(|found| found.class == class).count();
    let cut = (0..classes).map(|class| full_in_all || full(manifest.max_detections_per_class, of_class(class)));
    let cut = cut.collect();
    boxes.retain(|found| manifest.labels.get(found.class).is_some_and(Option::is_some));
    let unusable = |found: &&Candidate| !found.corners.iter().chain([&found.score]).all(|value| value.is_finite());
    if let Some(Candidate { corners, score, class }) = boxes.iter().find(unusable) {
        return Err(outputs.failed(format!("its box {corners:?} of class {class} with score {score} is not finite")));
    }
    if manifest.coordinates == Coordinates::Normalised {
        let [width, height] = [manifest.input.width, manifest.input.height].map(f64::from);
        for found in &mut boxes {
            let [x1, y1, x2, y2] = found.corners;
            found.corners = [x1 * width, y1 * height, x2 * width, y2 * height];
        }
    }
    Ok(Candidates { boxes, cut })
}

fn torchvision(outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    let [boxes, labels, scores] = ["boxes", "labels", "scores"].map(|name| outputs.named(name));
    parallel(outputs, boxes?, labels?, scores?)
}

/// Boxes, classes and scores in tensors of their own.
fn parallel(
    outputs: &Outputs,
    boxes: &Output,
    labels: &Output,
    scores: &Output,
) -> Result<Vec<Candidate>, RuntimeError> {
    let count = scores.values.len();
    for (tensor, expected) in [(boxes, 4 * count), (labels, count)] {
        if tensor.values.len() != expected {
            let problem = format!("has shape {:?} beside {count} scores", tensor.shape);
            return Err(outputs.error(&tensor.name, problem));
        }
    }
    let rows = boxes.values.as_chunks::<4>().0.iter().zip(&labels.values).zip(&scores.values);
    Ok(rows.map(|((corners, label), score)| candidate(*corners, *score, *label)).collect())
}

fn efficient_nms(outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    // Their names differ from exporter to exporter; their order is the plugin's.
    let [counts, boxes, scores, classes] = &outputs.tensors[..] else {
        let count = outputs.tensors.len();
        return Err(outputs.failed(format!("it has {count} outputs of numbers; efficient_nms has 4")));
    };
    let mut rows = parallel(outputs, boxes, classes, scores)?;
    match counts.values[..] {
        // What lies behind the count is of another image.
        [count] if (0.0..=rows.len() as f32).contains(&count) => rows.truncate(whole(count)),
        _ => {
            let problem = format!("is {:?} beside {} boxes", counts.values, rows.len());
            return Err(outputs.error(&counts.name, problem));
        }
    }
    Ok(rows)
}

fn end2end(outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    let output = outputs.first()?;
    if output.shape.len() != 3 || output.shape[2] != 6 {
        return Err(outputs.error(&output.name, format!("has shape {:?}, expected [1, N, 6]", output.shape)));
    }
    let row = |&[x1, y1, x2, y2, score, class]: &[f32; 6]| candidate([x1, y1, x2, y2], score, class);
    Ok(output.values.as_chunks().0.iter().map(row).collect())
}

fn yolov7(outputs: &Outputs) -> Result<Vec<Candidate>, RuntimeError> {
    let output = outputs.first()?;
    if output.shape.len() != 2 || output.shape[1] != 7 {
        return Err(outputs.error(&output.name, format!("has shape {:?}, expected [N, 7]", output.shape)));
    }
    let row = |&[_, x1, y1, x2, y2, class, score]: &[f32; 7]| candidate([x1, y1, x2, y2], score, class);
    Ok(output.values.as_chunks().0.iter().map(row).collect())
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

fn candidate(corners: [f32; 4], score: f32, class: f32) -> Candidate {
    let usable = (0.0..1e6).contains(&class.round()) && (class - class.round()).abs() < 1e-3;
    let class = if usable { whole(class.round()) } else { NO_CLASS };
    Candidate { corners: corners.map(f64::from), score: f64::from(score), class }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be a small number from 0 on")]
fn whole(value: f32) -> usize {
    value as usize
}
